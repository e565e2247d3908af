//! Messages that a recording lacks: published = in the bag + gaps, whatever the reason is.

use std::time::Duration;

use sm2_bag::{Bag, GapReason, Options, Report, check};
use sm2_node::Name;
use sm2_proto::Instant;
use sm2_proto::link::Fate;

use crate::common::{Domain, named, record};
use crate::disk::Disk;

/// The counts of the gaps of a topic, by reason.
fn lost(report: &Report, reason: GapReason) -> u64 {
    let gaps = report.topics.iter().flat_map(|it| &it.gaps);
    gaps.filter(|it| it.reason == reason)
        .map(|it| it.messages)
        .sum()
}

/// Also those behind the last message that is in the bag, and those of a topic that has no other.
#[test]
fn messages_that_are_too_long_are_counted() {
    let domain = Domain::new();
    let talker = domain.node("talker");
    let both = talker.publisher::<[u8]>("both").unwrap();
    let long = talker.publisher::<[u8]>("long").unwrap();
    let node = domain.node("recorder");
    let options = Options {
        max_len_bytes: 100_000,
        // A message that is longer than the budget is never written.
        budget_bytes: 90_000,
        ..Options::new(named(&["both", "long"]))
    };
    let lengths = [100_001, 100_000, 100_001, 7, 100_001];
    let report = record(&node, domain.create("bag"), options, |record_until| {
        for publisher in [&both, &long] {
            record_until(&mut |_| publisher.links().iter().any(|it| it.open));
        }
        for len in lengths {
            both.publish(&vec![1; len]).unwrap();
        }
        for _ in 0..2 {
            long.publish(&[2; 200_000]).unwrap();
        }
        record_until(&mut |it| it.progress().messages == 1 && it.progress().lost == 6);
        record_until(&mut |it| it.progress().too_long == 5);
    });
    let counts = |it: &sm2_bag::TopicReport| (it.name.clone(), it.messages, it.lost);
    let counts: Vec<_> = report.topics.iter().map(counts).collect();
    assert_eq!(counts, [("both".into(), 1, 4), ("long".into(), 0, 2)]);
    assert_eq!(report.too_long(), 5);
    // They are one gap.
    assert_eq!(report.topics[1].gaps.len(), 1);
    assert_eq!(lost(&report, GapReason::Budget), 1);
    let bag = Bag::open(&domain.path("bag")).unwrap();
    assert_eq!(bag.report(), report);
    assert_eq!(check(bag.path()).unwrap().damages, []);
}

/// The reasons of the gaps of the only topic, and the messages of the bag and the gaps together.
fn reasons_and_sum(report: &Report) -> (Vec<GapReason>, u64) {
    let topic = &report.topics[0];
    let mut reasons: Vec<_> = topic.gaps.iter().map(|it| it.reason).collect();
    reasons.sort_unstable();
    reasons.dedup();
    (reasons, topic.messages + topic.lost)
}

/// The recorder holds long messages in the memory of their publisher. A publisher with little memory loses some while
/// the disk stalls, and then the recorder copies its messages at once: the budget is the only limit.
#[test]
fn a_publisher_with_little_memory_is_named_as_the_limit_and_relieved() {
    const LEN: usize = 100_000;
    let domain = Domain::new();
    let talker = domain.node("talker");
    let data = talker.publisher_builder::<[u8]>("data");
    let data = data.pool_limit(8 * LEN as u64).declare().unwrap();
    let node = domain.node("recorder");
    let (disk, gate) = Disk::with_gate(&domain, "bag");
    let options = Options {
        sync_interval: Duration::from_millis(5),
        ..Options::new(named(&["data"]))
    };
    let mut published = 0;
    let report = record(&node, disk, options, |record_until| {
        record_until(&mut |_| data.links().iter().any(|it| it.open));
        let mut publish = || {
            published += 1;
            data.publish(&[published as u8; LEN]).unwrap();
            published
        };
        gate.set(true);
        record_until(&mut |it| {
            publish();
            it.progress().lost > 0
        });
        gate.set(false);
        record_until(&mut |it| it.progress().waiting_bytes == 0);
        // The first message after the loss tells how many are missing.
        let mut before = 0;
        let count = publish();
        record_until(&mut |it| {
            before = it.progress().lost;
            it.progress().messages + before == count
        });
        gate.set(true);
        for _ in 0..30 {
            let count = publish();
            record_until(&mut |it| {
                let waiting = it.progress().waiting_bytes / LEN as u64;
                it.progress().messages + it.progress().lost + waiting == count
            });
        }
        record_until(&mut |it| it.progress().lost == before);
        gate.set(false);
        record_until(&mut |it| it.progress().waiting_bytes == 0);
    });
    let expected = (vec![GapReason::Unsent(Fate::PoolLimit)], published);
    assert_eq!(reasons_and_sum(&report), expected, "{report:?}");
    assert_eq!(Bag::open(&domain.path("bag")).unwrap().report(), report);
}

/// Messages that were displaced before do not hide them, also if the counters were not read for those.
#[test]
fn messages_that_a_publisher_with_little_memory_drops_at_the_end_are_counted() {
    const LEN: usize = 100_000;
    let domain = Domain::new();
    let talker = domain.node("talker");
    let data = talker.publisher_builder::<[u8]>("data");
    let data = data.pool_limit(8 * LEN as u64).declare().unwrap();
    let node = domain.node("recorder");
    let options = Options {
        // No time passes, so the counters are read for the first loss only.
        monotonic_clock: || Instant(1),
        ..Options::new(named(&["data"]))
    };
    let mut published = 0;
    let report = record(&node, domain.create("bag"), options, |record_until| {
        record_until(&mut |_| data.links().iter().any(|it| it.open));
        let mut publish = |count: u64, len: usize| {
            for _ in 0..count {
                data.publish(&vec![1; len]).unwrap();
            }
            published += count;
            published
        };
        for _ in 0..2 {
            // More than wait for the recorder.
            let count = publish(120, 10);
            record_until(&mut |it| it.progress().messages + it.progress().lost == count);
        }
        publish(30, LEN);
    });
    let reasons = vec![GapReason::Displaced, GapReason::Unsent(Fate::PoolLimit)];
    assert_eq!(reasons_and_sum(&report), (reasons, published), "{report:?}");
}

/// Messages that were displaced and that are shown later do not hide them, where the publisher displaces (in a ring)
/// and where the recorder does: the socket lane carries sealed messages.
#[test]
fn messages_that_a_publisher_drops_behind_displaced_ones_are_counted() {
    const LEN: usize = 100_000;
    for sealed in [false, true] {
        let domain = Domain::new();
        let talker = domain.node("talker");
        let data = talker.publisher_builder::<[u8]>("data").sealed(sealed);
        // The first long message is half of the memory.
        let data = data.pool_limit(2 * LEN as u64).declare().unwrap();
        let node = domain.node("recorder");
        let options = Options::new(named(&["data"]));
        // More than wait for the recorder, and more than the publisher keeps for it.
        let (short, long) = (200, 30);
        let report = record(&node, domain.create("bag"), options, |record_until| {
            record_until(&mut |_| data.links().iter().any(|it| it.open));
            assert_eq!(data.links()[0].ring, !sealed);
            for _ in 0..short {
                data.publish(&[1; 10]).unwrap();
            }
            for _ in 0..long {
                data.publish(&[2; LEN]).unwrap();
            }
            record_until(&mut |it| it.progress().messages + it.progress().lost == short + long);
        });
        assert!(lost(&report, GapReason::Displaced) > 0, "{report:?}");
        let expected = (
            vec![GapReason::Displaced, GapReason::Unsent(Fate::PoolLimit)],
            short + long,
        );
        assert_eq!(reasons_and_sum(&report), expected, "{report:?}");
    }
}

/// No later message shows that they are missing.
#[test]
fn messages_that_the_recorder_takes_too_late_have_expired() {
    let domain = Domain::new();
    let talker = domain.node("talker");
    let data = talker.publisher_builder::<u64>("data");
    let data = data.lifespan(Duration::from_millis(1)).declare().unwrap();
    let node = domain.node("recorder");
    let options = Options::new(named(&["data"]));
    let report = record(&node, domain.create("bag"), options, |record_until| {
        record_until(&mut |_| data.links().iter().any(|it| it.open));
        for number in 0..3 {
            data.publish(&number).unwrap();
        }
        std::thread::sleep(Duration::from_millis(5));
    });
    let expected = (vec![GapReason::Unsent(Fate::Expired)], 3);
    assert_eq!(reasons_and_sum(&report), expected, "{report:?}");
}

#[test]
fn messages_for_which_a_publisher_does_not_wait_are_counted() {
    let domain = Domain::new();
    let talker = domain.node("talker");
    let data = talker.publisher_builder::<[u8]>("data");
    let data = data.reliable(true).publish_timeout(Duration::ZERO);
    let data = data.declare().unwrap();
    let node = domain.node("recorder");
    let options = Options {
        reliable: [Name::new("data").unwrap()].into(),
        ..Options::new(named(&["data"]))
    };
    let report = record(&node, domain.create("bag"), options, |record_until| {
        record_until(&mut |_| data.links().iter().any(|it| it.open));
        // Nobody takes them meanwhile.
        for _ in 0..200 {
            data.publish(&[1; 100]).unwrap();
        }
    });
    let expected = (vec![GapReason::Unsent(Fate::NoRoom)], 200);
    assert_eq!(reasons_and_sum(&report), expected, "{report:?}");
    assert!(report.topics[0].messages > 0);
}

/// Those of each publisher, also if the recorder has not heard of it before.
#[test]
fn messages_that_wait_at_the_end_are_recorded() {
    let domain = Domain::new();
    let talkers = ["left", "right"].map(|it| domain.node(it));
    let all = talkers.map(|it| it.publisher::<u64>("data").unwrap());
    let node = domain.node("recorder");
    let options = Options::new(named(&["data"]));
    let report = record(&node, domain.create("bag"), options, |record_until| {
        for data in &all {
            record_until(&mut |_| data.links().iter().any(|it| it.open));
        }
        for data in &all {
            for number in 0..60 {
                data.publish(&number).unwrap();
            }
        }
    });
    assert_eq!(reasons_and_sum(&report), (vec![], 120), "{report:?}");
}

#[test]
fn messages_that_a_late_recorder_loses_were_displaced() {
    let domain = Domain::new();
    let data = domain.node("talker").publisher::<u64>("data").unwrap();
    let node = domain.node("recorder");
    let options = Options::new(named(&["data"]));
    let report = record(&node, domain.create("bag"), options, |record_until| {
        record_until(&mut |_| data.links().iter().any(|it| it.open));
        for number in 0..200 {
            data.publish(&number).unwrap();
        }
    });
    let expected = (vec![GapReason::Displaced], 200);
    assert_eq!(reasons_and_sum(&report), expected, "{report:?}");
}
