//! Checks of SM2 that are not tests of one crate.
//!
//! No other crate depends on this one; `verification/check` calls its binaries. `README.md` beside it
//! describes the checks and their limits.

use std::{
    env,
    path::{Path, PathBuf},
};

pub mod clauses;
pub mod model;
pub mod mutants;
pub mod properties;
pub mod results;
pub mod test_targets;

/// The folder above this crate when Cargo runs us, else the current one.
#[must_use]
pub fn workspace() -> PathBuf {
    env::var_os("CARGO_MANIFEST_DIR")
        .as_deref()
        .map(Path::new)
        .and_then(Path::parent)
        .map_or_else(|| PathBuf::from("."), Path::to_owned)
}
