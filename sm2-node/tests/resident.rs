//! The memory of messages. In its own file: the test examines all segments of its process.

use sm2_test_support::ran_alone;
use std::collections::BTreeMap;
use std::fs;
use std::os::unix::fs::MetadataExt;
use std::time::Duration;

use crate::common::{Domain, Endpoint, meet, next, until};
use sm2_node::{Publisher, Sample, Subscriber};

const LEN: usize = 10_000_000;
/// The most memory that a message occupies: whole huge pages, and a page for its head.
const MESSAGE: u64 = (10 << 20) + 4096;

/// Returns the present memory and the size of all segments of this process, as reported by the kernel.
fn segments() -> (u64, u64) {
    let mut files = BTreeMap::new();
    for entry in fs::read_dir("/proc/self/fd").unwrap() {
        let path = entry.unwrap().path();
        let is_segment =
            |to: std::path::PathBuf| to.to_string_lossy().contains("memfd:sm2-segment");
        if fs::read_link(&path).is_ok_and(is_segment)
            && let Ok(file) = fs::metadata(&path)
        {
            files.insert(file.ino(), (file.blocks() * 512, file.len()));
        }
    }
    let sum = |one: fn(&(u64, u64)) -> u64| files.values().map(one).sum();
    (sum(|file| file.0), sum(|file| file.1))
}

/// Returns how many mappings of segments this process has.
fn mappings() -> usize {
    let maps = fs::read_to_string("/proc/self/maps").unwrap();
    (maps
        .lines()
        .filter(|line| line.contains("memfd:sm2-segment")))
    .count()
}

fn publish(publisher: &Publisher<[u8]>, mark: u8) {
    let mut loan = publisher.loan_slice(LEN).unwrap();
    loan.fill(mark);
    assert_eq!(loan.publish().unwrap().missed, 0);
}

/// Takes a message with each subscriber, which holds it until it has the next one.
fn take(subscribers: &[Subscriber<[u8]>], held: &mut [Option<Sample<[u8]>>], mark: u8) {
    for (subscriber, held) in subscribers.iter().zip(held) {
        let sample = next(subscriber);
        assert!(sample.len() == LEN && sample[0] == mark && sample[LEN - 1] == mark);
        *held = Some(sample);
    }
}

#[test]
fn few_slots_are_ever_touched_and_those_of_a_rush_are_given_back() {
    if ran_alone(concat!(
        module_path!(),
        "::few_slots_are_ever_touched_and_those_of_a_rush_are_given_back"
    )) {
        return;
    }
    let domain = Domain::new();
    let talker = domain.node("talker");
    let builder = talker.publisher_builder::<[u8]>("topic");
    // Longer than the time between two messages, also on a busy machine.
    let idle = Duration::from_millis(300);
    let publisher = builder.keep_idle(idle).declare().unwrap();
    let subscribers: Vec<_> = (0..5)
        .map(|number| {
            let node = domain.node(&format!("listener-{number}"));
            let builder = node.subscriber_builder::<[u8]>("topic");
            builder.max_borrowed(8).declare().unwrap()
        })
        .collect();
    let ends: Vec<&dyn Endpoint> = subscribers.iter().map(|it| it as &dyn Endpoint).collect();
    meet(&publisher, &ends);

    let mut held = [const { None }; 5];
    for mark in 1..=30 {
        publish(&publisher, mark);
        take(&subscribers, &mut held, mark);
        let (present, _) = segments();
        assert!(
            present <= 2 * MESSAGE,
            "{present} bytes for one publisher and five subscribers that hold one"
        );
    }
    assert_eq!(mappings(), 2 * (1 + 5), "every node maps each segment once");

    // All subscribers hold eight messages, and then only the last one.
    let mut rush = Vec::new();
    for mark in 1..=7 {
        rush.extend(held.iter_mut().map(Option::take));
        publish(&publisher, mark);
        take(&subscribers, &mut held, mark);
    }
    let (present, _) = segments();
    assert!(
        present > 7 * LEN as u64 && present <= 8 * MESSAGE,
        "{present}"
    );
    drop(rush);
    // The publisher frees what was idle for a while as it publishes.
    let mut mark = 0_u8;
    until(|| {
        mark = mark.wrapping_add(1);
        publish(&publisher, mark);
        take(&subscribers, &mut held, mark);
        segments().0 <= 2 * MESSAGE
    });
    let (_, size) = segments();
    assert_eq!(
        size,
        2 * (12 << 20),
        "the two segments that were there before"
    );
    assert_eq!(publisher.pool_bytes(), size);
}
