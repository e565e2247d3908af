//! The recorder of a bag.

use std::collections::BTreeMap;
use std::fs::File;

use nix::errno::Errno;
use nix::fcntl::{Flock, FlockArg};
use serde::Serialize;

/// The recorder that writes a bag.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct WrittenBy {
    /// Its node.
    pub node: String,
    /// Its process number.
    pub process: u32,
    /// When it began with this file, in nanoseconds of the wall clock.
    pub since_ns: u64,
}

impl WrittenBy {
    /// The name of its metadata record.
    pub(crate) const RECORD: &str = "sm2.recorder";

    pub(crate) fn metadata(&self) -> BTreeMap<String, String> {
        [
            ("node", self.node.clone()),
            ("process", self.process.to_string()),
            ("since_ns", self.since_ns.to_string()),
        ]
        .map(|(key, value)| (key.to_owned(), value))
        .into()
    }

    pub(crate) fn from_metadata(metadata: &BTreeMap<String, String>) -> Option<Self> {
        Some(Self {
            node: metadata.get("node")?.clone(),
            process: metadata.get("process")?.parse().ok()?,
            since_ns: metadata.get("since_ns")?.parse().ok()?,
        })
    }
}

/// Whether a recorder has this file open: it locks the file for as long.
pub(crate) fn is_being_written(file: &File) -> bool {
    // The lock ends with the copy of the descriptor.
    let locked = file
        .try_clone()
        .map(|it| Flock::lock(it, FlockArg::LockSharedNonblock));
    matches!(locked, Ok(Err((_, Errno::EWOULDBLOCK))))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_record_has_all_of_it() {
        let written_by = WrittenBy {
            node: "recorder".to_owned(),
            process: 7,
            since_ns: 9,
        };
        let read = WrittenBy::from_metadata(&written_by.metadata());
        assert_eq!(read, Some(written_by));
    }
}
