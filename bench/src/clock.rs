//! The monotonic clock, which all processes of the machine share.

use std::time::Duration;

use nix::time::{ClockId, ClockNanosleepFlags, clock_gettime, clock_nanosleep};

/// Nanoseconds since an unspecified time, which is the same for all processes.
///
/// # Panics
///
/// If the kernel has no monotonic clock.
#[must_use]
pub fn now_ns() -> u64 {
    let time = clock_gettime(ClockId::CLOCK_MONOTONIC).expect("every Linux has this clock");
    Duration::from(time).as_nanos() as u64
}

/// Sleeps until this time; returns at once if it has passed.
pub fn sleep_until(at_ns: u64) {
    let at = Duration::from_nanos(at_ns).into();
    let flags = ClockNanosleepFlags::TIMER_ABSTIME;
    // A signal interrupts the sleep; the time is absolute, so that it stays the same.
    while clock_nanosleep(ClockId::CLOCK_MONOTONIC, flags, &at).is_err() {}
}
