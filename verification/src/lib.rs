//! Checks of SM2 that are not tests of one crate.
//!
//! It is no part of the product: no other crate depends on it, and `verification/check` calls its
//! binaries. `README.md` beside this crate says what is checked, where, and how far that goes.

use std::{
    env,
    path::{Path, PathBuf},
};

pub mod clauses;
pub mod model;
pub mod mutants;
pub mod properties;
pub mod results;

/// The folder above this crate when Cargo runs us, else the current one.
#[must_use]
pub fn workspace() -> PathBuf {
    env::var_os("CARGO_MANIFEST_DIR")
        .as_deref()
        .map(Path::new)
        .and_then(Path::parent)
        .map_or_else(|| PathBuf::from("."), Path::to_owned)
}
