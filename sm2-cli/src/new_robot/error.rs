//! The errors of `sm2 new`.

use std::path::PathBuf;

/// The folder was not made.
#[derive(Debug, thiserror::Error)]
pub(crate) enum NewError {
    /// Something has the name.
    #[error("{} exists, and is not changed: choose another name", .0.display())]
    Exists(PathBuf),
    /// The path of `--sm2-path` is no clone of the repository.
    #[error("{} has no sm2-node/Cargo.toml: name the folder of a clone of SM2's repository", .0.display())]
    NotSm2(PathBuf),
    /// The path of `--sm2-path` is not UTF-8, as a manifest has to be.
    #[error("{} is not UTF-8, so no Cargo.toml can name it: move the clone", .0.display())]
    NotText(PathBuf),
}
