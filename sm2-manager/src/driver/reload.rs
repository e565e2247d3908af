//! The state of reading the access policy again while the Manager serves.

use std::path::PathBuf;

use crate::Options;

/// Whether the policy is read again, and which one is being applied.
#[derive(Debug)]
pub(super) struct PolicyReload {
    pub(super) options: Options,
    /// Whether the policy has to be read as soon as this Manager holds the lock.
    pub(super) is_due: bool,
    /// The path of the policy that is being applied, if the domain has one.
    pub(super) applying: Option<Option<PathBuf>>,
}

impl PolicyReload {
    pub(super) fn new(options: &Options) -> Self {
        Self {
            options: options.clone(),
            is_due: false,
            applying: None,
        }
    }

    pub(super) const fn ask(&mut self) {
        self.is_due = true;
    }
}
