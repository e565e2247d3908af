//! The names of new files and folders.

use std::io;
use std::path::{Path, PathBuf};

/// The name with this number, from 1 on: `stem`, `stem-2`, `stem-3`, and so forth.
#[must_use]
pub fn numbered(stem: &str, number: u64) -> String {
    match number {
        1 => stem.to_owned(),
        number => format!("{stem}-{number}"),
    }
}

/// Creates the first path that does not exist, of those with the numbers 1, 2, 3, and so forth. Returns it with the
/// result of `create`, whose error is another one than `AlreadyExists`.
pub fn create_first<T>(
    path: impl Fn(u64) -> PathBuf,
    mut create: impl FnMut(&Path) -> io::Result<T>,
) -> (PathBuf, io::Result<T>) {
    let mut number = 1;
    loop {
        let path = path(number);
        match create(&path) {
            Err(error) if error.kind() == io::ErrorKind::AlreadyExists => number += 1,
            created => return (path, created),
        }
    }
}
