//! What the end-to-end tests of SM2 share: domains in temporary folders, child
//! processes, raw peers that send hand-written bytes, and counting what
//! a process holds.
//!
//! | module | what |
//! | --- | --- |
//! | [`domain`] | a folder of its own for each test, and Managers that serve there |
//! | [`process`] | children with bounded waits; none outlives its test |
//! | [`actor`] | a child that is a node and does what it is told |
//! | [`random`] | choices that can be made again |
//! | [`census`] | descriptors and mappings of a process, from `/proc` |
//! | [`raw`] | peers that speak bytes: a node, a Manager, one end of a link |
//! | [`control`], [`link`] | frames written by hand, from SPEC alone |
//! | [`ring`] | both ends of a ring, moved by hand |
//! | [`pattern`] | payloads whose every byte can be checked |
//! | [`memory`] | files to attach, with the seals that a test wants |
//! | [`violations`] | the table of everything that SPEC forbids |
//!
//! Nothing here asserts how long something takes. Every wait is bounded by
//! [`TIMEOUT`], which only a deadlock exceeds.
//!
//! A helper panics where a test would have to fail: that is what `# Panics` would
//! say on each of them.

use std::time::{Duration, Instant};

pub mod actor;
pub mod census;
pub mod control;
#[cfg(doctest)]
mod documents;
pub mod domain;
pub mod link;
pub mod memory;
pub mod pattern;
pub mod process;
pub mod random;
pub mod raw;
pub mod ring;
pub mod violations;

/// How long anything may take before it counts as a deadlock.
pub const TIMEOUT: Duration = Duration::from_secs(60);

/// Waits until `done` says so.
///
/// The test fails, naming `what`, if that takes longer than [`TIMEOUT`].
#[track_caller]
pub fn eventually(what: &str, done: impl FnMut() -> bool) {
    assert!(in_time(done), "waited in vain: {what}");
}

/// Whether `done` says so within [`TIMEOUT`].
pub fn in_time(mut done: impl FnMut() -> bool) -> bool {
    let start = Instant::now();
    let mut pause = Duration::from_micros(200);
    while !done() {
        if start.elapsed() > TIMEOUT {
            return false;
        }
        std::thread::sleep(pause);
        pause = (pause * 2).min(Duration::from_millis(20));
    }
    true
}
