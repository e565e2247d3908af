//! The monotonic clock of the host.

use nix::libc;
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
    instant(events::monotonic().expect("Linux has a monotonic clock"))
}

/// The time of the last tick of the kernel on `CLOCK_MONOTONIC`, in nanoseconds: up to 10 ms ago. Several times faster
/// than [`now`].
///
/// # Panics
///
/// As for [`now`].
#[must_use]
#[inline]
pub fn last_tick() -> Instant {
    instant(events::last_tick().expect("Linux has a coarse clock"))
}

#[inline]
fn instant(time: libc::timespec) -> Instant {
    // The clock starts near zero at boot, so neither part is negative; 64 bits last for 584 years.
    Instant(time.tv_sec.cast_unsigned() * 1_000_000_000 + time.tv_nsec.cast_unsigned())
}
