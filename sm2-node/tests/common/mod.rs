//! A domain of one's own, for each test.
#![allow(dead_code, reason = "each test uses its own part")]

use std::time::Duration;

use sm2_manager::{Background, Options, Policy};
use sm2_node::Node;

/// Long enough for a machine that is busy with other tests.
pub(crate) const SOON: Duration = Duration::from_secs(10);

/// A Manager, with its socket in a temporary folder.
pub(crate) struct Domain {
    manager: Option<Background>,
    folder: tempfile::TempDir,
}

impl Domain {
    pub(crate) fn new() -> Self {
        Self::with(Policy::default())
    }

    pub(crate) fn with(policy: Policy) -> Self {
        let folder = tempfile::tempdir().unwrap();
        let options = Options {
            policy,
            ..Options::default()
        };
        let manager = Background::start(&folder.path().join("test.sock"), options).unwrap();
        Self {
            manager: Some(manager),
            folder,
        }
    }

    pub(crate) fn socket(&self) -> std::path::PathBuf {
        self.folder.path().join("test.sock")
    }

    pub(crate) fn node(&self, name: &str) -> Node {
        Node::builder(name).socket(self.socket()).connect().unwrap()
    }

    /// Stops the Manager. Nodes go on without it.
    pub(crate) fn stop(&mut self) {
        self.manager.take().unwrap().stop().unwrap();
    }
}

/// Bytes that differ from place to place and from message to message.
pub(crate) fn pattern(len: usize, seed: u64) -> Vec<u8> {
    let mut state = seed.wrapping_mul(0x9e37_79b9_7f4a_7c15) | 1;
    let word = |_| {
        state ^= state << 13;
        state ^= state >> 7;
        state ^= state << 17;
        state.to_le_bytes()
    };
    let mut bytes: Vec<u8> = (0..len.div_ceil(8)).flat_map(word).collect();
    bytes.truncate(len);
    bytes
}
