//! A case of a workload, and the figures that it gives.

use crate::{job::Read, peers::PeerInfo, world::Failure};

/// Options of the command line that hold for all cases.
#[derive(Clone, Debug)]
pub struct Options {
    /// How subscribers read messages.
    pub read: Read,
    /// How long each case counts, in seconds, if it is not the workload's own choice.
    pub seconds: Option<f64>,
    /// The length of large messages, in bytes.
    pub size: usize,
    /// How many nodes join, if it is not the workload's own choice.
    pub nodes: Option<usize>,
    /// The link also stands still, in a case of its own.
    pub pauses: bool,
}

/// Something that can be run on a peer.
pub trait Case {
    /// The prefix of its figures' names; empty if the workload has no other case.
    fn label(&self) -> String;

    /// Runs it once.
    ///
    /// # Errors
    ///
    /// See [`Failure`].
    fn run(&self, peer: &'static PeerInfo) -> Result<Vec<Figure>, Failure>;
}

/// One number of one run.
#[derive(Clone, Debug, PartialEq)]
pub struct Figure {
    /// Its name.
    pub name: &'static str,
    /// Its unit.
    pub unit: &'static str,
    /// Its value, in `unit`.
    pub value: f64,
}

/// A figure.
#[must_use]
pub const fn figure(name: &'static str, unit: &'static str, value: f64) -> Figure {
    Figure { name, unit, value }
}
