//! A descriptor that becomes readable at a given time.

use std::os::fd::AsFd;
use std::time::Duration;

use nix::fcntl::{FcntlArg, FdFlag, fcntl};
use sm2_io::{Timer, clock, wait_readable};
use sm2_proto::Instant;
use sm2_test_support::SOON;

fn readable(timer: &Timer, within: Duration) -> bool {
    wait_readable(&[timer.as_fd()], Some(within)).unwrap()
}

#[test]
fn readable_from_its_moment_on() {
    let timer = Timer::new().unwrap();
    let flags = FdFlag::from_bits_retain(fcntl(&timer, FcntlArg::F_GETFD).unwrap());
    assert!(flags.contains(FdFlag::FD_CLOEXEC));
    assert!(!timer.drain() && !readable(&timer, Duration::ZERO));
    for _ in 0..3 {
        let at = clock::now().after(Duration::from_millis(5));
        timer.set(Some(at)).unwrap();
        assert!(readable(&timer, SOON));
        assert!(clock::now() >= at, "never too early");
        // The timer stays readable until it is drained.
        assert!(readable(&timer, Duration::ZERO));
        assert!(timer.drain() && !timer.drain());
        assert!(!readable(&timer, Duration::ZERO));
    }
}

#[test]
fn moments_that_have_passed_count() {
    let timer = Timer::new().unwrap();
    let now = clock::now();
    for passed in [Instant(0), Instant(1), Instant(now.0 - 1), now] {
        timer.set(Some(passed)).unwrap();
        assert!(readable(&timer, SOON), "{passed:?}");
        assert!(timer.drain());
    }
}

#[test]
fn the_last_setting_counts() {
    let timer = Timer::new().unwrap();
    timer.set(Some(Instant(1))).unwrap();
    assert!(readable(&timer, SOON));
    // Clearing the timer also makes it unreadable.
    timer.set(None).unwrap();
    assert!(!readable(&timer, Duration::ZERO) && !timer.drain());
    for far in [clock::now().after(SOON * 1_000), Instant(u64::MAX)] {
        timer.set(Some(Instant(1))).unwrap();
        assert!(readable(&timer, SOON));
        timer.set(Some(far)).unwrap();
        assert!(!readable(&timer, Duration::ZERO) && !timer.drain());
    }
}
