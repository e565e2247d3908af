//! Shared parts of the programs that measure a cost: their argument, their domain and the median.

use std::error::Error;

use sm2_manager::{Background, Options};
use sm2_node::{Node, NodeBuilder};
use tempfile::TempDir;

/// A domain with a Manager in this process.
pub(crate) struct Domain {
    folder: TempDir,
    _manager: Background,
}

impl Domain {
    pub(crate) fn new() -> Result<Self, Box<dyn Error>> {
        let folder = tempfile::tempdir()?;
        let manager = Background::start(&folder.path().join(SOCKET), Options::default())?;
        Ok(Self {
            folder,
            _manager: manager,
        })
    }

    pub(crate) fn node(&self, name: &str) -> NodeBuilder {
        Node::builder(name).socket(self.folder.path().join(SOCKET))
    }
}

const SOCKET: &str = "domain.sock";

/// The first argument, the length of a message; 64 without one.
pub(crate) fn bytes() -> Result<usize, Box<dyn Error>> {
    Ok(std::env::args().nth(1).map_or(Ok(64), |it| it.parse())?)
}

pub(crate) fn median(mut values: Vec<f64>) -> f64 {
    values.sort_by(f64::total_cmp);
    values[values.len() / 2]
}
