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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_first_free_name_is_taken_and_another_error_ends_the_search() {
        for (last, expected) in [
            (Ok(7), Ok(7)),
            (
                Err(io::ErrorKind::PermissionDenied),
                Err(io::ErrorKind::PermissionDenied),
            ),
        ] {
            let mut asked = Vec::new();
            let (path, created) = create_first(
                |number| numbered("bag", number).into(),
                |path| {
                    asked.push(path.to_owned());
                    match asked.len() {
                        1 | 2 => Err(io::ErrorKind::AlreadyExists.into()),
                        3 => last.map_err(io::Error::from),
                        _ => unreachable!("the third one is the last"),
                    }
                },
            );
            assert_eq!(created.map_err(|it| it.kind()), expected);
            assert_eq!(path, Path::new("bag-3"));
            assert_eq!(asked, ["bag", "bag-2", "bag-3"].map(PathBuf::from));
        }
    }
}
