//! Errors of the store.

use std::io;
use std::path::{Path, PathBuf};

/// The reason why a store cannot be used, or does not have a message.
#[derive(Debug, thiserror::Error)]
pub enum StoreError {
    /// The operating system refuses a file.
    #[error("cannot {action} {}: {source}", path.display())]
    Io {
        /// The attempt.
        action: &'static str,
        /// The file or folder.
        path: PathBuf,
        /// The reason.
        r#source: io::Error,
    },
    /// Another outbox uses the folder.
    #[error("{} belongs to another bridge that runs; give each bridge a folder of its own", path.display())]
    Locked {
        /// The folder.
        path: PathBuf,
    },
    /// A file has fewer messages than were written to it.
    #[error("{} has lost messages since it was written", path.display())]
    Damaged {
        /// The file.
        path: PathBuf,
    },
}

impl StoreError {
    pub(super) fn io(action: &'static str, path: &Path) -> impl FnOnce(io::Error) -> Self {
        let path = path.to_owned();
        move |source| Self::Io {
            action,
            path,
            source,
        }
    }
}
