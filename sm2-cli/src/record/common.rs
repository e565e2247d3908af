//! The parts that a recording and a black box share.

use std::{
    fmt, io,
    path::{Path, PathBuf},
};

use sm2_bag::Progress;
use sm2_proto::text::Counted;

use crate::{error::CliError, size::Size};

/// A new name with the date and the time, in UTC.
pub(super) fn new_name(stem: &str) -> String {
    let now = jiff::Timestamp::now();
    format!("{stem}-{}", now.strftime("%Y-%m-%d-%H%M%S"))
}

/// New names with the date and the time, in UTC: the second one and all later ones have a number. A clock without a
/// battery gives two recordings the same time.
pub(super) fn new_names(stem: &str) -> impl Iterator<Item = String> {
    let first = new_name(stem);
    (1..).map(move |number| match number {
        1 => first.clone(),
        number => format!("{first}-{number}"),
    })
}

/// Creates the first one of these that does not exist.
///
/// # Errors
///
/// The error of `create` for it, unless it exists; then the next one's.
pub(super) fn create_first<T>(
    paths: impl Iterator<Item = PathBuf>,
    mut create: impl FnMut(&Path) -> io::Result<T>,
) -> Result<(PathBuf, T), CliError> {
    for path in paths {
        match create(&path) {
            Ok(created) => return Ok((path, created)),
            Err(error) if error.kind() == io::ErrorKind::AlreadyExists => {}
            Err(error) => return Err(CliError::file("create", &path, error)),
        }
    }
    let taken = io::ErrorKind::AlreadyExists.into();
    Err(CliError::file("create", Path::new("."), taken))
}

/// The progress, as it is shown on a terminal.
pub(super) struct Shown(pub(super) Progress);

impl fmt::Display for Shown {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Progress {
            topics,
            not_recorded,
            messages,
            bytes,
            lost,
            waiting_bytes,
        } = self.0;
        write!(
            f,
            "{}: {} ({}), lost {lost}, {} waiting for the disk",
            Counted::new(topics as u64, "topic"),
            Counted::new(messages, "message"),
            Size(bytes),
            Size(waiting_bytes)
        )?;
        match not_recorded {
            0 => Ok(()),
            count => write!(f, ", {} not recorded", Counted::new(count as u64, "topic")),
        }
    }
}
