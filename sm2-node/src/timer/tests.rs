//! The timer in virtual time.

use std::time::Duration;

use proptest::prelude::*;
use sm2_proto::Instant;

use super::{MissedTicks, Tick, Timer};

const START: Instant = Instant(1_000);

fn timer(period_ns: u64) -> Timer {
    Timer::starting_at(START, Duration::from_nanos(period_ns))
}

fn tick(number: u64, due: u64, missed: u64) -> Option<Tick> {
    let due = Instant(due);
    Some(Tick {
        number,
        due,
        missed,
    })
}

#[test]
fn late_handling_does_not_move_later_ticks() {
    let mut timer = timer(100);
    assert_eq!(timer.handle(Instant(1_099)), None);
    assert_eq!(timer.handle(Instant(1_190)), tick(1, 1_100, 0));
    assert_eq!(timer.deadline(), Some(Instant(1_200)));
    assert_eq!(timer.handle(Instant(1_200)), tick(2, 1_200, 0));
}

#[test]
fn skipping_reports_the_newest_of_the_missed_ticks() {
    let mut timer = timer(100);
    assert_eq!(timer.handle(Instant(1_350)), tick(3, 1_300, 2));
    assert_eq!(timer.handle(Instant(1_350)), None);
    assert_eq!(timer.deadline(), Some(Instant(1_400)));
}

#[test]
fn a_burst_reports_each_of_the_missed_ticks() {
    let mut timer = timer(100).missed_ticks(MissedTicks::Burst);
    for number in 1..=3 {
        let due = START.0 + 100 * number;
        assert_eq!(timer.handle(Instant(1_350)), tick(number, due, 0));
    }
    assert_eq!(timer.handle(Instant(1_350)), None);
    assert_eq!(timer.deadline(), Some(Instant(1_400)));
}

#[test]
fn a_frequency_is_exact_although_its_period_is_no_whole_number_of_nanoseconds() {
    let mut timer = Timer::hz(3);
    timer.start = Instant(0);
    for number in 1..=9_000 {
        let due = timer.deadline().unwrap();
        assert_eq!(due, Instant(number * 1_000_000_000 / 3));
        assert_eq!(timer.handle(Instant(due.0 - 1)), None);
        assert_eq!(timer.handle(due), tick(number, due.0, 0));
    }
    assert_eq!(timer.deadline(), Some(Instant(3_000_333_333_333)));
}

#[test]
fn another_frequency_begins_anew_and_the_same_one_changes_nothing() {
    let mut timer = Timer::hz(10).missed_ticks(MissedTicks::Burst);
    timer.set_hz(20, START);
    assert_eq!(timer.handle(Instant(50_001_000)), tick(1, 50_001_000, 0));
    timer.set_hz(20, Instant(90_000_000));
    assert_eq!(timer.deadline(), Some(Instant(100_001_000)));
    timer.set_hz(0, Instant(90_000_000));
    assert_eq!(timer.deadline(), Some(Instant(1_090_000_000)));
    timer.set_hz(1, Instant(95_000_000));
    assert_eq!(timer.deadline(), Some(Instant(1_090_000_000)));
    // Missed ticks still come one after the other.
    let late = Instant(4_000_000_000);
    assert_eq!(timer.handle(late), tick(1, 1_090_000_000, 0));
    // A timer that ticks once ticks again and again from now on.
    let mut once = Timer::once(Duration::from_secs(1));
    once.set_hz(1, START);
    assert_eq!(once.handle(late), tick(3, 3_000_001_000, 2));
}

#[test]
fn one_tick_is_all_of_a_timer_that_does_not_repeat() {
    let mut timer = Timer::once(Duration::from_nanos(100));
    timer.start = START;
    assert_eq!(timer.handle(Instant(1_099)), None);
    // However late it is.
    assert_eq!(timer.handle(Instant(9_000)), tick(1, 1_100, 0));
    assert_eq!(timer.deadline(), None);
    assert_eq!(timer.handle(Instant(u64::MAX)), None);
}

#[test]
fn extreme_values_neither_panic_nor_tick_early() {
    let mut never = Timer::starting_at(START, Duration::MAX);
    assert_eq!(never.deadline(), Some(Instant(u64::MAX)));
    assert_eq!(never.handle(Instant(u64::MAX - 1)), None);
    let mut dense = Timer::starting_at(START, Duration::ZERO);
    assert_eq!(dense.deadline(), Some(Instant(START.0 + 1)));
    let last = u64::MAX - START.0;
    assert_eq!(
        dense.handle(Instant(u64::MAX)),
        tick(last, u64::MAX, last - 1)
    );
    assert_eq!(Timer::hz(0).span_ns, 1_000_000_000);
    assert_eq!(Timer::hz(0).ticks, 1);
}

proptest! {
    /// For all times of handling: each tick is at its place, none is early, and none is lost without a count.
    #[test]
    fn ticks_are_on_a_grid_and_all_counted(
        span_ns in 1..1_000_u64,
        ticks in 1..50_u32,
        burst: bool,
        pauses in proptest::collection::vec(0..3_000_u64, 1..100),
    ) {
        let missed = if burst { MissedTicks::Burst } else { MissedTicks::Skip };
        let mut timer = Timer { span_ns, ticks, ..timer(1) }.missed_ticks(missed);
        let (mut now, mut count) = (START, 0);
        for pause in pauses {
            now.0 += pause;
            while let Some(tick) = timer.handle(now) {
                count += 1 + tick.missed;
                prop_assert_eq!(tick.number, count);
                prop_assert!(tick.missed == 0 || !burst);
                let passed = u128::from(tick.number) * u128::from(span_ns) / u128::from(ticks);
                prop_assert_eq!(u128::from(tick.due.0 - START.0), passed);
                prop_assert!(tick.due <= now);
            }
            prop_assert!(timer.deadline().unwrap() > now);
        }
    }
}
