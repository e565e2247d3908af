//! The parts that the tests of all crates share: one time limit, printed seeds, skipped tests that are seen, processes
//! of their own, and a place for files.
//!
//! It depends on no other crate of SM2, so that every crate can use it.

mod memory;
mod own_process;
mod scheduling;
mod seed;
mod skip;
mod stopped;

use std::time::{Duration, Instant};

pub use memory::memory;
pub use own_process::ran_alone;
pub use scheduling::Scheduling;
pub use seed::{below, seed};
pub use skip::{skip, skip_without};
pub use stopped::wait_until_stopped;

/// The time limit of everything that has to succeed. It is far beyond what a loaded machine needs, and costs nothing
/// when the test passes. Tests that are built for an emulated processor, which is far slower, have ten times as long:
/// `SM2_EMULATED` is set then.
pub const SOON: Duration = Duration::from_secs(match option_env!("SM2_EMULATED") {
    Some(_) => 600,
    None => 60,
});

/// Returns once `is_so` does, which it tries every millisecond.
///
/// # Panics
///
/// It still does not after [`SOON`].
#[track_caller]
pub fn until(what: &str, mut is_so: impl FnMut() -> bool) {
    let end = Instant::now() + SOON;
    while !is_so() {
        assert!(Instant::now() < end, "{what}: not within {SOON:?}");
        std::thread::sleep(Duration::from_millis(1));
    }
}
