//! Memory that a publisher is done with is unmapped by those who still listen. The only test of its
//! file, since it counts what the whole process has mapped.

mod common;

use common::{Domain, meet, pattern, until};
use sm2_node::Subscriber;

fn segments() -> usize {
    let maps = std::fs::read_to_string("/proc/self/maps").unwrap();
    let is_segment = |line: &&str| line.contains("memfd:sm2-segment");
    maps.lines().filter(is_segment).count()
}

/// A subscriber is gone with a message in its hands, so that this memory is not written again; the
/// other one gives the message back, and nothing is published any more.
//= SM2-OPN-008 test
#[test]
fn what_is_not_used_again_is_unmapped_without_another_message() {
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
        assert_eq!(segments(), 3, "the publisher's, and one of each subscriber");
        drop(goes);
        until(|| publisher.links().iter().filter(|it| it.open).count() == 1);
        drop((held, lost));
        // Somebody looks at its counters, and finds what came back.
        until(|| publisher.counters().in_flight == 0);
        until(|| stays.links().len() == 1 && segments() == 0);
    }
}
