//! The monotonic clock, which all processes of a machine share.

use std::time::Duration;

use nix::time::{ClockId, ClockNanosleepFlags, clock_gettime, clock_nanosleep};

/// Nanoseconds since an unspecified moment, the same one for every process.
///
/// # Panics
///
/// If the kernel has no monotonic clock.
#[must_use]
pub fn now_ns() -> u64 {
    let time = clock_gettime(ClockId::CLOCK_MONOTONIC).expect("every Linux has this clock");
    Duration::from(time).as_nanos() as u64
}

/// Sleeps until this moment; not at all if it is over.
pub fn sleep_until(at_ns: u64) {
    let at = Duration::from_nanos(at_ns).into();
    let flags = ClockNanosleepFlags::TIMER_ABSTIME;
    // Interrupted by a signal: the moment is the same.
    while clock_nanosleep(ClockId::CLOCK_MONOTONIC, flags, &at).is_err() {}
}
