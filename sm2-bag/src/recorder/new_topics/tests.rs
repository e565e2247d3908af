use sm2_node::domain::{EntityId, InterfaceId, NodeId, OfferedQos};
use sm2_proto::TypeId;
use sm2_proto::control::Item;

use super::*;

fn name(text: &str) -> Name {
    Name::new(text).unwrap()
}

/// A domain with one topic.
fn domain(topic: &str) -> Domain {
    let node = NodeId(1);
    let mut domain = Domain::new();
    domain.page([
        Item::Node {
            node,
            name: name("talker"),
            uid: 0,
            pid: 1,
            resuming: false,
            max_links: None,
        },
        Item::Interface {
            entity: EntityId {
                node,
                interface: InterfaceId(1),
            },
            contract: Contract::Publisher {
                topic: name(topic),
                data: TypeId {
                    name: name("bytes"),
                    hash: 0,
                },
                offer: OfferedQos::new(1),
            },
        },
    ]);
    domain
}

/// All topics that are not recorded count; the bag has room for the names of the first ones.
#[test]
fn the_bag_names_the_first_topics_that_are_missing() {
    let mut missed = Missed::default();
    let topics = NAMED_MAX + 2;
    for number in 0..topics {
        missed.add(&name(&format!("topic_{number}")), &"no room", 7);
    }
    assert_eq!((missed.count, missed.named), (topics, NAMED_MAX));
    assert_eq!(
        (missed.now.len(), missed.changes.len()),
        (topics, NAMED_MAX)
    );
    missed.retain(|_| false, 8);
    assert_eq!((missed.now.len(), missed.changes.len()), (0, 2 * NAMED_MAX));
}

/// A domain that has not changed is not looked at for each topic that has its turn.
#[test]
fn the_domain_is_looked_at_after_a_change() {
    let mut it = NewTopics::new(&Topics::All);
    // No process has room for this.
    it.reserve = usize::MAX / 2;
    it.domain_changed();
    assert_eq!(it.next(&domain("scan"), &mut [], 1), None);
    assert_eq!((it.missed(), it.has_next()), (1, false));
    // Nobody has said that the domain has another topic now.
    let other = domain("image");
    it.resume();
    assert_eq!(it.next(&other, &mut [], 2), None);
    assert_eq!(it.waiting, [name("scan")]);
    it.domain_changed();
    it.resume();
    assert_eq!(it.next(&other, &mut [], 3), None);
    assert_eq!(it.waiting, [name("image")]);
    it.reserve = 0;
    it.resume();
    assert_eq!(it.next(&other, &mut [], 4), Some(name("image")));
}
