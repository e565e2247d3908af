//! Domain time: sources, jumps, pauses, and timers that follow them.

// Shows CLK-FOLLOW (test), bound: nodes with and without a background thread, on both lanes.

use std::thread;
use std::time::{Duration, SystemTime, UNIX_EPOCH};

use crate::common::fixture::Fixture;
use crate::common::threads::while_asleep;
use crate::common::{SOON, until};
use sm2_node::clock::{Clock, ClockSource, DomainTime};
use sm2_node::{MissedTicks, WaitSet, now};

const REAL_TIME: u64 = 1_000_000_000;
const SECOND: Duration = Duration::from_secs(1);

fn wall_ns() -> u64 {
    let wall = SystemTime::now().duration_since(UNIX_EPOCH).unwrap();
    u64::try_from(wall.as_nanos()).unwrap()
}

/// A source whose time stands at 0, and the clock of a node that follows it.
fn stopped(fixture: &Fixture) -> (ClockSource, Clock) {
    let source = ClockSource::new(&fixture.peer("player")).unwrap();
    source.set(DomainTime(0), 0).unwrap();
    let clock = fixture.node("robot").clock().unwrap();
    until(|| clock.reading().is_some());
    (source, clock)
}

//= SM2-CLK-003 test
#[test]
fn without_a_source_domain_time_is_the_wall_clock() {
    Fixture::each(|it| {
        let clock = it.node("robot").clock().unwrap();
        let (before, time, after) = (wall_ns(), clock.now().0, wall_ns());
        assert!(before <= time && time <= after, "{before} {time} {after}");
        assert_eq!(clock.reading(), None);
    });
}

//= SM2-CLK-001, SM2-CLK-002, SM2-CLK-003 test
#[test]
fn a_node_follows_the_source_that_was_there_before() {
    Fixture::each(|it| {
        let source = ClockSource::new(&it.peer("player")).unwrap();
        source.set(DomainTime(5), 0).unwrap();
        let newest = source.set(DomainTime(1_000), 0).unwrap();
        let node = it.node("robot");
        let clock = node.clock().unwrap();
        until(|| clock.reading().is_some());
        assert_eq!(clock.reading(), Some(newest));
        assert_eq!(clock.now(), DomainTime(1_000));
        assert_eq!(clock.instant(DomainTime(1_001)), None);

        let running = source.set(DomainTime(2_000), REAL_TIME / 2).unwrap();
        until(|| clock.reading() == Some(running));
        assert_eq!(
            clock.instant(DomainTime(3_000)).unwrap().0,
            running.at.0 + 2_000
        );
        let before = running.time(now());
        assert!(before <= clock.now() && clock.now() <= running.time(now()));
        // The source leaves: its last reading stays in force.
        drop(source);
        assert_eq!(clock.reading(), Some(running));
    });
}

#[test]
fn a_timer_ticks_with_domain_time_and_starts_again_after_a_jump_back() {
    Fixture::each(|it| {
        let (source, clock) = stopped(it);
        let mut timer = clock.every(SECOND);
        assert_eq!(
            (timer.try_tick(&clock), timer.deadline(&clock)),
            (None, None)
        );

        let set_to = |seconds: u64| {
            let reading = source.set(DomainTime(seconds * REAL_TIME), 0).unwrap();
            until(|| clock.reading() == Some(reading));
        };
        set_to(3);
        let tick = timer.try_tick(&clock).unwrap();
        assert_eq!(
            (tick.number, tick.missed, tick.due.0),
            (3, 2, 3 * REAL_TIME)
        );
        assert_eq!(timer.try_tick(&clock), None);
        set_to(1);
        assert_eq!(timer.try_tick(&clock), None);
        set_to(2);
        let tick = timer.try_tick(&clock).unwrap();
        assert_eq!(
            (tick.number, tick.missed, tick.due.0),
            (1, 0, 2 * REAL_TIME)
        );
    });
}

/// A timer keeps its rule for missed ticks when it starts again.
#[test]
fn a_burst_reports_each_missed_tick_after_a_jump_back_too() {
    Fixture::each(|it| {
        let (source, clock) = stopped(it);
        let mut timer = clock.every(SECOND).missed_ticks(MissedTicks::Burst);
        assert_eq!(timer.try_tick(&clock), None);
        let set_to = |seconds: u64| {
            let reading = source.set(DomainTime(seconds * REAL_TIME), 0).unwrap();
            until(|| clock.reading() == Some(reading));
        };
        // The second row is after a jump back, from which the ticks are counted.
        for (start, now) in [(0, 3), (1, 4)] {
            if start > 0 {
                set_to(start);
                assert_eq!(timer.try_tick(&clock), None);
            }
            set_to(now);
            for number in 1..=3 {
                let tick = timer.try_tick(&clock).unwrap();
                assert_eq!((tick.number, tick.missed), (number, 0), "from {start}");
            }
            assert_eq!(timer.try_tick(&clock), None);
        }
    });
}

/// A reading ends the sleep of a timer, and is reported by a wait set.
#[test]
fn a_reading_wakes_sleepers() {
    Fixture::each(|it| {
        let (source, clock) = stopped(it);
        let mut timer = clock.every(SECOND);
        // The clock moves into a thread and back: it is for one thread at a time.
        let (tick, clock) = while_asleep(
            || (timer.sleep(&clock).unwrap(), clock),
            |_| {
                source.set(DomainTime(REAL_TIME), 0).unwrap();
            },
        );
        assert_eq!(tick.number, 1);

        let mut set = WaitSet::new().unwrap();
        set.add(&clock, ()).unwrap();
        while set.try_wait().unwrap().is_some() {
            let _ = clock.reading();
        }
        thread::scope(|scope| {
            scope.spawn(|| source.set(DomainTime(2 * REAL_TIME), 0).unwrap());
            assert!(set.wait_timeout(SOON).unwrap().is_some());
        });
        until(|| timer.try_tick(&clock).is_some());
    });
}

/// Every sleeper has a clock of its own, so a reading wakes all of them.
#[test]
fn a_reading_wakes_all_sleepers_of_a_node() {
    Fixture::each(|it| {
        let source = ClockSource::new(&it.peer("player")).unwrap();
        source.set(DomainTime(0), 0).unwrap();
        let node = it.node("robot");
        let clocks = [(); 3].map(|()| node.clock().unwrap());
        for clock in &clocks {
            until(|| clock.reading().is_some());
        }
        let [one, two, three] = clocks.map(|clock| {
            move || {
                let tick = clock.every(SECOND).sleep(&clock).unwrap();
                assert_eq!(tick.number, 1);
            }
        });
        let wake = || {
            source.set(DomainTime(REAL_TIME), 0).unwrap();
        };
        while_asleep(one, |_| {
            while_asleep(two, |_| while_asleep(three, |_| wake()));
        });
    });
}
