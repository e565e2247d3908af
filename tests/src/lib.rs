//! The shared parts of the end-to-end tests of SM2: domains in temporary folders, child processes, raw
//! peers that send hand-written bytes, and counts of a process' descriptors.
//!
//! | module | content |
//! | --- | --- |
//! | [`domain`] | a folder for each test, and Managers that serve there |
//! | [`process`] | child processes with bounded waits; none outlives its test |
//! | [`actor`] | a child process that is a node and carries out commands |
//! | [`options`], [`input`] | the command line and the standard input of a child process |
//! | [`manager`], [`gateway`] | the Manager and the gateway as child processes run them |
//! | [`random`] | random choices that a seed reproduces |
//! | [`census`] | descriptors and mappings of a process, from `/proc` |
//! | [`raw`] | peers that send bytes: a node, a Manager, one end of a link |
//! | [`control`], [`link`] | frames written by hand, from SPEC alone |
//! | [`ring`] | both ends of a ring, written by hand |
//! | [`pattern`] | payloads whose bytes can all be checked |
//! | [`memory`] | files to attach, with the seals that a test wants |
//! | [`violations`] | the table of everything that SPEC forbids |
//!
//! Nothing here asserts how long something takes. Every wait is bounded by
//! [`TIMEOUT`], which only a deadlock exceeds.
//!
//! Helpers panic if the test has failed; their documentation does not repeat this under `# Panics`.

use std::time::{Duration, Instant};

pub mod actor;
pub mod census;
pub mod control;
#[cfg(doctest)]
mod documents;
pub mod domain;
pub mod gateway;
pub mod input;
pub mod link;
pub mod manager;
pub mod memory;
pub mod options;
pub mod pattern;
pub mod process;
pub mod random;
pub mod raw;
pub mod ring;
pub mod violations;

/// The timeout of all waits; exceeding it counts as a deadlock.
pub const TIMEOUT: Duration = sm2_test_support::SOON;

/// Waits until `done` returns true.
///
/// The test fails, naming `what`, if that takes longer than [`TIMEOUT`].
#[track_caller]
pub fn eventually(what: &str, done: impl FnMut() -> bool) {
    assert!(in_time(done), "waited in vain: {what}");
}

/// True if `done` returns true within [`TIMEOUT`].
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
