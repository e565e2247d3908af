//! The monotonic clock of the host.

use sm2_proto::Instant;

use crate::syscall::events;

/// The current time of `CLOCK_MONOTONIC`, in nanoseconds.
///
/// All processes of a host read the same clock; it does not count time
/// during which the host is suspended.
///
/// # Panics
///
/// Never on Linux, where this clock always exists.
#[must_use]
#[inline]
pub fn now() -> Instant {
    let time = events::monotonic().expect("Linux has a monotonic clock");
    // The clock starts near zero at boot, so neither part is negative; 64 bits last for 584 years.
    Instant(time.tv_sec().cast_unsigned() * 1_000_000_000 + time.tv_nsec().cast_unsigned())
}
