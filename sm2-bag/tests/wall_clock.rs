//! A wall clock that steps during a recording.

use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Duration;

use sm2_bag::{Bag, Filter, Options, check};
use sm2_node::clock::{DomainTime, wall_time};

use crate::common::{Domain, named, record};

const HOUR_NS: u64 = 3_600_000_000_000;

/// How far the clock of the recorder is ahead of that of the machine.
static AHEAD_NS: AtomicU64 = AtomicU64::new(0);

fn stepping_clock() -> DomainTime {
    let DomainTime(now) = wall_time();
    DomainTime(now + AHEAD_NS.load(Ordering::Relaxed))
}

#[test]
fn steps_of_an_hour_are_recorded_and_cost_no_message() {
    let domain = Domain::new();
    let publisher = domain.node("talker").publisher::<[u8]>("data").unwrap();
    let options = Options {
        sync_interval: Duration::from_millis(1),
        wall_clock: stepping_clock,
        ..Options::new(named(&["data"]))
    };
    // The clock steps an hour forwards, two hours back, and an hour forwards.
    let clocks = [HOUR_NS, 2 * HOUR_NS, 0, HOUR_NS];
    AHEAD_NS.store(clocks[0], Ordering::Relaxed);
    let node = domain.node("recorder");
    let report = record(&node, domain.create("bag"), options, |record_until| {
        record_until(&mut |_| publisher.links().iter().any(|it| it.open));
        for (number, ahead_ns) in (1..).zip(clocks) {
            AHEAD_NS.store(ahead_ns, Ordering::Relaxed);
            // Several intervals, so that the recorder compares the clocks.
            let mut calls = 0;
            record_until(&mut |_| {
                calls += 1;
                calls > 5
            });
            publisher.publish(&[number]).unwrap();
            record_until(&mut |it| it.progress().messages == u64::from(number));
        }
    });
    assert!(report.complete);
    assert_eq!((report.topics[0].messages, report.topics[0].lost), (4, 0));
    let bag = Bag::open(&domain.path("bag")).unwrap();
    assert_eq!(bag.report(), report);
    assert_eq!(check(bag.path()).unwrap().damages, []);

    // The times of the messages do not step: the relations of the clocks tell the steps.
    let messages = bag.messages(&Filter::default());
    let times: Vec<_> = messages.map(|it| it.unwrap().log_time).collect();
    assert!(times.is_sorted(), "{times:?}");
    assert!(times[3] - times[0] < HOUR_NS, "{times:?}");
    let ahead = |index: usize| {
        let clock = bag.clocks()[index];
        clock
            .wall_ns
            .abs_diff(bag.clocks()[0].wall_at(clock.monotonic))
    };
    assert_eq!(bag.clocks().len(), 4, "{:?}", bag.clocks());
    let tolerance = HOUR_NS / 60;
    for (index, expected) in [HOUR_NS, HOUR_NS, 0].into_iter().enumerate() {
        let is = ahead(index + 1);
        assert!(is.abs_diff(expected) < tolerance, "step {index}: {is} ns");
    }
}
