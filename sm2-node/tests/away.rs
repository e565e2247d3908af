//! Messages that are published while a publisher and a subscriber have no link: the subscriber counts them.

use std::fs::{self, Permissions};
use std::os::unix::fs::PermissionsExt;

use crate::common::{Domain, LANES, SOON, away, back, meet, next, pattern, until};
use nix::libc;
use sm2_io::fault::{Call, Fault, Injector};
use sm2_node::{Event, Node, Publisher, Subscriber};

/// Published while there is no link.
const MEANWHILE: u64 = 5;

/// The message of this number. Each needs a longer slot than the one before, so a publisher needs the socket also on
/// the ring lane.
fn message(number: u64) -> Vec<u8> {
    pattern(300 << number.min(12), number)
}

/// A publisher and a subscriber, whose nodes the calls of this thread drive alone.
struct Pair {
    publisher: Publisher<[u8]>,
    subscriber: Subscriber<[u8]>,
    nodes: [Node; 2],
}

impl Pair {
    fn new(domain: &Domain, ring: bool, latched: u16) -> Self {
        let node = |name| {
            let builder = domain.builder(name).ring_lane(ring).background(false);
            builder.connect().unwrap()
        };
        let nodes = [node("talker"), node("listener")];
        let publisher = nodes[0].publisher_builder("topic").latched(latched);
        let subscriber = nodes[1].subscriber_builder("topic").depth(64);
        let it = Self {
            publisher: publisher.declare().unwrap(),
            subscriber: subscriber.declare().unwrap(),
            nodes,
        };
        it.meet();
        it.subscriber.events();
        it
    }

    fn meet(&self) {
        meet(&self.publisher, &[&self.subscriber]);
    }

    fn publish(&self, numbers: impl IntoIterator<Item = u64>) {
        for number in numbers {
            self.publisher.publish(&message(number)).unwrap();
        }
    }

    /// Takes this message. Returns how many messages were lost before it.
    #[track_caller]
    fn take(&self, number: u64) -> u64 {
        let sample = next(&self.subscriber);
        assert_eq!(sample.sequence(), number);
        assert!(*sample == *message(number));
        sample.lost()
    }

    /// The link ends at the publisher, with this message: the kernel has no room for a descriptor.
    fn break_link(&self, number: u64) {
        let faults = Injector::counting();
        let installed = faults.install();
        faults.set([Fault {
            call: Call::SendMsg,
            nth: 1,
            times: 1,
            errno: libc::ETOOMANYREFS,
        }]);
        self.publish([number]);
        drop(installed);
        assert_eq!(faults.hits(), 1);
        assert!(!self.publisher.links().iter().any(|it| it.open));
    }

    /// The lost messages, and those of them that were published while there was no link.
    fn lost(&self) -> (u64, u64) {
        (self.subscriber.lost(), self.subscriber.away())
    }

    /// The sum of the losses of the events, all of the publisher.
    fn lost_by_events(&self) -> u64 {
        let events = self.subscriber.events();
        let mut sum = 0;
        while let Some(event) = events.try_next().unwrap() {
            if let Event::Lost { peer, messages } = event {
                assert_eq!(peer.name.as_str(), "talker");
                sum += messages;
            }
        }
        sum
    }
}

/// A link that ends for want of descriptors is made again. The messages of the first link that wait in its socket or
/// ring are taken first.
//= SM2-QOS-013 test
#[test]
fn messages_between_two_links_are_counted_once() {
    for ring in LANES {
        let domain = Domain::new();
        let pair = Pair::new(&domain, ring, 0);
        pair.publish(1..=3);
        assert_eq!(pair.take(1), 0);
        pair.break_link(4);
        let after = 5 + MEANWHILE;
        pair.publish(5..after);
        assert_eq!(pair.lost(), (0, 0));
        // The node of the subscriber was not driven, so its end of the link opens only now.
        pair.meet();
        pair.publish([after]);
        assert_eq!((pair.take(2), pair.take(3)), (0, 0), "ring {ring}");
        let missed = MEANWHILE + 1;
        assert_eq!(pair.take(after), missed, "ring {ring}");
        assert_eq!(pair.lost(), (missed, missed));
        assert_eq!(pair.lost_by_events(), missed);
        let links = pair.subscriber.links();
        let counts: Vec<_> = links
            .iter()
            .map(|it| (it.received.lost, it.received.away))
            .collect();
        assert_eq!(counts, [(0, 0), (0, missed)]);
        pair.publish([after + 1]);
        assert_eq!(pair.take(after + 1), 0);
        assert_eq!(pair.lost(), (missed, missed));
    }
}

/// Messages that are left of an older link come before those of the same publisher, and of no other one.
//= SM2-QOS-013 test
#[test]
fn messages_of_one_publisher_delay_no_other_one() {
    for ring in LANES {
        let domain = Domain::new();
        let pair = Pair::new(&domain, ring, 0);
        let builder = domain.builder("other").ring_lane(ring).background(false);
        let node = builder.connect().unwrap();
        let other = node.publisher::<[u8]>("topic").unwrap();
        until(|| {
            let links = [other.links(), pair.subscriber.links()];
            links.iter().flatten().filter(|it| it.open).count() == 3
        });
        pair.publish([1]);
        assert_eq!(pair.take(1), 0);
        // The link of the other publisher is over, with a message in it that the program has not taken.
        other.publish(&message(1)).unwrap();
        drop(other);
        drop(node);
        until(|| pair.subscriber.links().iter().any(|it| !it.open));
        pair.break_link(2);
        pair.meet();
        assert_eq!(pair.lost(), (1, 1), "ring {ring}");
    }
}

/// A node that declares its publisher anew has another publisher: messages that are left of the first one's link do not
/// delay what is counted for the second one.
//= SM2-QOS-013 test
#[test]
fn messages_of_an_earlier_publisher_delay_no_later_one_of_the_node() {
    for ring in LANES {
        let domain = Domain::new();
        let mut pair = Pair::new(&domain, ring, 0);
        pair.publish([1]);
        let other = pair.nodes[0].publisher("other").unwrap();
        drop(std::mem::replace(&mut pair.publisher, other));
        until(|| pair.subscriber.links().iter().any(|it| !it.open));
        pair.publisher = pair.nodes[0].publisher("topic").unwrap();
        pair.meet();
        pair.break_link(1);
        pair.meet();
        assert_eq!(pair.lost(), (1, 1), "ring {ring}");
        // The message of the first publisher has not been taken before.
        assert_eq!(pair.take(1), 0);
    }
}

/// The next Manager makes the link anew, because it had ended before: OPEN says what was published meanwhile.
//= SM2-QOS-013, SM2-OPN-006 test
#[test]
fn one_message_counts_as_soon_as_there_is_a_link_again() {
    for ring in LANES {
        let mut domain = Domain::new();
        let pair = Pair::new(&domain, ring, 0);
        pair.publish([1]);
        assert_eq!(pair.take(1), 0);
        domain.stop();
        let [talker, listener] = &pair.nodes;
        away(&[talker, listener]);
        pair.break_link(2);
        domain.start();
        back(&[talker, listener]);
        pair.meet();
        // No message has come on the new link.
        assert_eq!(pair.lost(), (1, 1), "ring {ring}");
        assert_eq!(pair.lost_by_events(), 1);
        pair.publish([3]);
        assert_eq!(pair.take(3), 1, "the message reports it");
        assert_eq!(pair.lost(), (1, 1), "and does not count it again");
    }
}

//= SM2-QOS-013 test
#[test]
fn a_latched_publisher_sends_some_of_them_again() {
    for ring in LANES {
        let domain = Domain::new();
        let pair = Pair::new(&domain, ring, 2);
        pair.publish([1]);
        assert_eq!(pair.take(1), 0);
        pair.break_link(2);
        pair.publish(3..=6);
        pair.meet();
        // 5 and 6 are the latched ones.
        assert_eq!(pair.take(5), 3, "ring {ring}");
        assert_eq!((pair.take(6), pair.lost()), (0, (3, 3)));
        // Nothing was published meanwhile but the message that broke the link, which comes again after one that was
        // taken before.
        pair.break_link(7);
        pair.meet();
        assert_eq!((pair.take(6), pair.take(7), pair.lost()), (0, 0, (3, 3)));
        assert_eq!(pair.lost_by_events(), 3);
    }
}

/// A subscriber that comes for the first time misses nothing, and neither does one that meets another publisher.
//= SM2-QOS-013 test
#[test]
fn another_publisher_begins_anew() {
    let domain = Domain::new();
    let pair = Pair::new(&domain, true, 0);
    pair.publish(1..=3);
    assert_eq!((pair.take(1), pair.take(2), pair.take(3)), (0, 0, 0));
    let Pair {
        publisher,
        subscriber,
        nodes,
    } = pair;
    drop(publisher);
    let publisher = nodes[0].publisher::<[u8]>("topic").unwrap();
    for number in 1..=4 {
        publisher.publish(&message(number)).unwrap();
    }
    meet(&publisher, &[&subscriber]);
    publisher.publish(&message(5)).unwrap();
    let sample = next(&subscriber);
    assert_eq!((sample.sequence(), sample.lost()), (5, 0));
    assert_eq!((subscriber.lost(), subscriber.away()), (0, 0));
}

/// A policy denies the publisher for a while: its messages in the link are lost, and those that it publishes meanwhile
/// are away.
//= SM2-QOS-013, SM2-ACC-014 test
#[test]
fn messages_of_a_suspended_publisher_are_counted() {
    for ring in LANES {
        let domain = Domain::new();
        let node = |name| domain.builder(name).ring_lane(ring).connect().unwrap();
        let (talker, listener, tool) = (node("talker"), node("listener"), node("tool"));
        let publisher = talker.publisher::<u64>("topic").unwrap();
        let builder = listener.subscriber_builder::<u64>("topic");
        let subscriber = builder.depth(64).declare().unwrap();
        meet(&publisher, &[&subscriber]);
        let file = domain.socket().with_file_name("test.sock.policy");
        let apply = |rule: &str| {
            fs::write(&file, format!("default = \"allow\"\n{rule}")).unwrap();
            fs::set_permissions(&file, Permissions::from_mode(0o644)).unwrap();
            tool.reload_policy(SOON).unwrap();
        };
        publisher.publish(&1).unwrap();
        assert_eq!(*next(&subscriber), 1);
        publisher.publish(&2).unwrap();
        publisher.publish(&3).unwrap();
        apply(
            "[[rule]]\nname = \"quiet\"\neffect = \"deny\"\nactions = [\"publish\"]\nnames = [\"topic\"]\n",
        );
        until(|| subscriber.lost() == 2);
        assert_eq!(subscriber.away(), 0);
        for number in 4..4 + MEANWHILE {
            publisher.publish(&number).unwrap();
        }
        apply("");
        meet(&publisher, &[&subscriber]);
        let counts = || (subscriber.lost(), subscriber.away());
        assert_eq!(counts(), (2 + MEANWHILE, MEANWHILE), "ring {ring}");
        publisher.publish(&100).unwrap();
        let sample = next(&subscriber);
        assert_eq!((*sample, sample.lost()), (100, 2 + MEANWHILE));
        assert_eq!(counts(), (2 + MEANWHILE, MEANWHILE));
    }
}
