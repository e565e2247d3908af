//! The cases of a workload, and their figures.

use std::path::PathBuf;

use crate::{job::Read, peers::PeerInfo, world::Failure};

/// Options of the command line that apply to all cases.
#[derive(Clone, Debug)]
pub struct Options {
    /// The part of each message that subscribers read.
    pub read: Read,
    /// The duration of the counted part of each case, in seconds; `None` is the workload's default.
    pub seconds: Option<f64>,
    /// The length of large messages, in bytes.
    pub size: usize,
    /// The number of nodes that join; `None` is the workload's default.
    pub nodes: Option<usize>,
    /// True to add a case where the link pauses at times.
    pub pauses: bool,
    /// The folder of recorded files; `None` is the system's folder for temporary files.
    pub folder: Option<PathBuf>,
    /// The amount of data that is recorded, in GB; `None` is the workload's default.
    pub gigabytes: Option<f64>,
    /// Frames per second that are recorded; `None` is as fast as the recorder takes them.
    pub frame_rate: Option<f64>,
}

/// A measurement that can run on any peer.
pub trait Case {
    /// The prefix of the names of its figures; empty if the workload has no other case.
    fn label(&self) -> String;

    /// Runs the case once.
    ///
    /// # Errors
    ///
    /// See [`Failure`].
    fn run(&self, peer: &'static PeerInfo) -> Result<Vec<Figure>, Failure>;
}

/// One number of one run.
#[derive(Clone, Debug, PartialEq)]
pub struct Figure {
    /// The name.
    pub name: &'static str,
    /// The unit.
    pub unit: &'static str,
    /// The value, in `unit`.
    pub value: f64,
}

/// Makes a figure.
#[must_use]
pub const fn figure(name: &'static str, unit: &'static str, value: f64) -> Figure {
    Figure { name, unit, value }
}
