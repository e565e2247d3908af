//! A wall clock that steps during a recording.

use std::ops::ControlFlow;
use std::path::Path;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Duration;

use sm2_bag::{
    Bag, BagFiles, Compression, Filter, Options, RestampError, Restamped, check, copy, messages,
    restamp,
};
use sm2_node::clock::{DomainTime, wall_time};

use crate::common::{Domain, RecordUntil, named, record};

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
            compare_clocks(record_until);
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

/// Records for several intervals, so that the recorder compares the clocks.
fn compare_clocks(record_until: &mut RecordUntil<'_>) {
    let mut calls = 0;
    record_until(&mut |_| {
        calls += 1;
        calls > 5
    });
}

/// How far another clock is ahead of that of the machine, once it is corrected.
static CORRECTION_NS: AtomicU64 = AtomicU64::new(0);

fn corrected_clock() -> DomainTime {
    let DomainTime(now) = wall_time();
    DomainTime(now + CORRECTION_NS.load(Ordering::Relaxed))
}

/// Records two messages, corrects the clock by an hour unless it is `corrected`, and records two more.
fn record_corrected(domain: &Domain, name: &str, corrected: bool) {
    let publisher = domain.node("talker").publisher::<[u8]>("data").unwrap();
    let options = Options {
        sync_interval: Duration::from_millis(1),
        wall_clock: corrected_clock,
        ..Options::new(named(&["data"]))
    };
    CORRECTION_NS.store(if corrected { HOUR_NS } else { 0 }, Ordering::Relaxed);
    let node = domain.node("recorder");
    record(&node, domain.create(name), options, |record_until| {
        record_until(&mut |_| publisher.links().iter().any(|it| it.open));
        for number in 1..=4 {
            if number == 3 {
                CORRECTION_NS.store(HOUR_NS, Ordering::Relaxed);
                compare_clocks(record_until);
            }
            publisher.publish(&[number]).unwrap();
            record_until(&mut |it| it.progress().messages == u64::from(number));
        }
    });
}

fn restamped(from: &Path, to: &Path) -> Result<Restamped, RestampError> {
    let bags = BagFiles::find(from).unwrap();
    let bags = bags.open(&mut |_| ControlFlow::Continue(())).unwrap();
    restamp(&bags, to, Compression::None, &mut |_| {
        ControlFlow::Continue(())
    })
}

/// All times follow the clock as it was before it was corrected: all of them move.
#[test]
fn times_are_corrected_when_the_clock_was() {
    let domain = Domain::new();
    let path = |name: &str| domain.path(name);
    record_corrected(&domain, "early", false);
    let (early, right) = (path("early"), path("right"));
    let Restamped {
        shift_ns,
        steps,
        corrected_at_ns,
        report,
    } = restamped(&early, &right).unwrap();
    assert_eq!((steps, report.topics[0].messages), (1, 4));
    let tolerance = i128::from(HOUR_NS / 60);
    assert!(
        (shift_ns - i128::from(HOUR_NS)).abs() < tolerance,
        "{shift_ns}"
    );
    let [before, after] = [&early, &right].map(|it| Bag::open(it).unwrap());
    let times = |bag: &Bag| -> Vec<_> {
        let all = bag.messages(&Filter::default()).map(|it| it.unwrap());
        all.map(|it| (it.log_time, it.publish_time, it.data))
            .collect()
    };
    let moved = |time: u64| u64::try_from(i128::from(time) + shift_ns).unwrap();
    let expected = times(&before).into_iter();
    let expected: Vec<_> = expected
        .map(|(log, publish, data)| (moved(log), moved(publish), data))
        .collect();
    assert_eq!(times(&after), expected);
    // Two of the messages were recorded before the correction.
    let is_before = |it: &&(u64, u64, Vec<u8>)| it.0 < corrected_at_ns;
    assert_eq!(expected.iter().filter(is_before).count(), 2);
    let [clock] = after.clocks() else {
        panic!("{:?}", after.clocks());
    };
    assert_eq!(clock.wall_ns, moved(before.clocks()[0].wall_ns));
    assert_eq!(check(&right).unwrap().damages, []);

    // There is nothing more to correct, and so it is with a clock that was right from the start.
    let none = path("none");
    let again = restamped(&right, &none);
    assert!(matches!(again, Err(RestampError::NoStep)), "{again:?}");
    record_corrected(&domain, "whole", true);
    let whole = restamped(&path("whole"), &none);
    assert!(matches!(whole, Err(RestampError::NoStep)), "{whole:?}");
    // Each recording has a clock of its own.
    let both = ["early", "whole"].map(|it| Bag::open(&path(it)).unwrap());
    copy(&both, &path("both"), &Filter::default(), Compression::None).unwrap();
    let several = restamped(&path("both"), &none);
    assert!(
        matches!(several, Err(RestampError::SeveralRecordings)),
        "{several:?}"
    );
    assert!(!none.exists());
    assert_files_have_one_clock(&domain, (shift_ns, corrected_at_ns));
}

/// The files of one recording have one clock.
fn assert_files_have_one_clock(domain: &Domain, (shift_ns, corrected_at_ns): (i128, u64)) {
    let path = |name: &str| domain.path(name);
    let early = path("early");
    let folder = path("files");
    std::fs::create_dir(&folder).unwrap();
    for (name, from_ns, to_ns) in [
        ("a.mcap", None, Some(corrected_at_ns)),
        ("b.mcap", Some(0), None),
    ] {
        let filter = Filter {
            from_ns,
            to_ns,
            ..Filter::default()
        };
        let bags = [Bag::open(&early).unwrap()];
        copy(&bags, &folder.join(name), &filter, Compression::None).unwrap();
    }
    let all = path("all");
    assert_eq!(restamped(&folder, &all).unwrap().shift_ns, shift_ns);
    let all = [Bag::open(&all).unwrap()];
    assert_eq!(messages(&all, &Filter::default()).count(), 8);
}

#[test]
fn a_bag_of_another_program_has_no_clock() {
    let folder = tempfile::tempdir().unwrap();
    let (path, to) = (folder.path().join("other"), folder.path().join("to"));
    let mut writer = mcap::Writer::new(std::fs::File::create(&path).unwrap()).unwrap();
    writer
        .add_channel(0, "data", "", &Default::default())
        .unwrap();
    writer.finish().unwrap();
    let refused = restamped(&path, &to);
    assert!(
        matches!(refused, Err(RestampError::NoRelation)),
        "{refused:?}"
    );
    assert!(!to.exists());
}
