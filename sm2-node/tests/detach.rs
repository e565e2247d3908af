//! A subscriber unmaps memory that its publisher no longer uses. In its own file: the test counts the
//! mappings of the whole process.

use crate::common;
use crate::common::{Domain, meet, pattern, until};
use sm2_node::Subscriber;
use sm2_test_support::ran_alone;

fn segments() -> usize {
    let maps = std::fs::read_to_string("/proc/self/maps").unwrap();
    let is_segment = |line: &&str| line.contains("memfd:sm2-segment");
    maps.lines().filter(is_segment).count()
}

/// One subscriber ends while it holds a message, so that this memory is not written again. The other one
/// releases the message, and nothing is published any more.
//= SM2-OPN-010 test
#[test]
fn what_is_not_used_again_is_unmapped_without_another_message() {
    if ran_alone(concat!(
        module_path!(),
        "::what_is_not_used_again_is_unmapped_without_another_message"
    )) {
        return;
    }
    for ring in [true, false] {
        let domain = Domain::new();
        let node = |name: &str| domain.node_on(ring, name);
        let publisher = node("talker").publisher::<[u8]>("topic").unwrap();
        let [stays, goes] = ["stays", "goes"].map(|name| {
            let subscriber: Subscriber<[u8]> = node(name).subscriber("topic").unwrap();
            subscriber
        });
        meet(&publisher, &[&stays, &goes]);
        publisher.publish(&pattern(100_000, 1)).unwrap();
        let [held, lost] = [&stays, &goes].map(common::next);
        assert_eq!(
            segments(),
            3,
            "one mapping of the publisher and one of each subscriber"
        );
        drop(goes);
        until(|| publisher.links().iter().filter(|it| it.open).count() == 1);
        drop((held, lost));
        // Reading the counters makes the publisher notice the release, and then give the memory back.
        until(|| {
            let counters = publisher.counters();
            counters.in_flight == 0 && stays.links().len() == 1 && segments() == 0
        });
    }
}
