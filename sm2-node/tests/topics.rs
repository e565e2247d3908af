//! Topics: messages of all sizes, and errors of declarations.

use crate::common::{Domain, SOON, meet, next, pair, pattern};
use sm2_node::zerocopy::{FromBytes, Immutable, IntoBytes, KnownLayout};
use sm2_node::{DeclareError, Message, Node, Publisher, Subscriber};

#[derive(Message, FromBytes, IntoBytes, Immutable, KnownLayout, Clone, Copy, Debug, PartialEq)]
#[message(name = "test/Pose")]
#[repr(C)]
struct Pose {
    stamp: u64,
    position: [f64; 3],
}

#[test]
fn every_form_carries_every_size_unchanged() {
    let sizes = [0, 1, 4095, 4096, 4097, 65_537, 1 << 20, (2 << 20) + 1];
    for (sealed, inline_max) in [
        (false, 4096),
        (true, 4096),
        (false, 0),
        (true, 0),
        (false, 61_440),
    ] {
        let domain = Domain::new();
        let (publisher, subscriber) = pair::<[u8]>(
            &domain,
            |node| {
                let builder = node.publisher_builder("bytes").sealed(sealed);
                builder.inline_max(inline_max).declare().unwrap()
            },
            |node| node.subscriber("bytes").unwrap(),
        );
        for (index, size) in sizes.into_iter().enumerate() {
            for (kind, seed) in [("publish", 1), ("loan", 2)] {
                let bytes = pattern(size, index as u64 * 2 + seed);
                let published = if kind == "loan" {
                    let mut loan = publisher.loan_slice(size).unwrap();
                    loan.copy_from_slice(&bytes);
                    loan.publish().unwrap()
                } else {
                    publisher.publish(&bytes).unwrap()
                };
                assert_eq!(published.links, 1);
                let sample = next(&subscriber);
                assert!(*sample == *bytes, "{kind}, {size} bytes, sealed {sealed}");
                assert_eq!(sample.sequence(), index as u64 * 2 + seed);
                assert_eq!(sample.lost(), 0);
                assert_eq!(sample.publisher().as_str(), "talker");
                assert!(sample.source_time() <= sm2_node::now());
            }
        }
    }
}

#[test]
fn one_message_serves_sealed_and_pooled_links() {
    let domain = Domain::new();
    let publisher = domain.node("talker").publisher::<[u8]>("bytes").unwrap();
    let pooled = domain.node("a").subscriber::<[u8]>("bytes").unwrap();
    let sealed = domain
        .node("b")
        .subscriber_builder::<[u8]>("bytes")
        .sealed(true)
        .declare()
        .unwrap();
    meet(&publisher, &[&pooled, &sealed]);
    let bytes = pattern(100_000, 3);
    assert_eq!(publisher.publish(&bytes).unwrap().links, 2);
    let mut loan = publisher.loan_slice(bytes.len()).unwrap();
    loan.copy_from_slice(&bytes);
    assert_eq!(loan.publish().unwrap().links, 2);
    for subscriber in [&pooled, &sealed] {
        for _ in 0..2 {
            assert!(*next(subscriber) == *bytes);
        }
    }
    let forms: Vec<_> = publisher.links().iter().map(|link| link.sealed).collect();
    assert_eq!(forms, [false, true]);
}

#[test]
fn typed_messages_are_read_in_place_or_decoded() {
    let domain = Domain::new();
    let (poses, seen) = pair::<Pose>(
        &domain,
        |node| {
            node.publisher_builder("pose")
                .inline_max(0)
                .declare()
                .unwrap()
        },
        |node| node.subscriber("pose").unwrap(),
    );
    let pose = Pose {
        stamp: 7,
        position: [1.0, 2.0, 3.0],
    };
    poses.publish(&pose).unwrap();
    assert_eq!(*next(&seen), pose);
    let mut loan = poses.loan().unwrap();
    *loan = pose;
    loan.stamp = 8;
    loan.publish().unwrap();
    assert_eq!(next(&seen).stamp, 8);
    drop(poses.loan().unwrap());

    let (node, other) = (domain.node("text-a"), domain.node("text-b"));
    let texts = node.publisher::<str>("text").unwrap();
    let read = other.subscriber::<String>("text").unwrap();
    meet(&texts, &[&read]);
    texts.publish("grüße").unwrap();
    assert_eq!(*next(&read), "grüße");
}

//= SM2-IFC-005 test
#[test]
fn a_type_mismatch_names_both_types() {
    let domain = Domain::new();
    let talker = domain.node("talker");
    let _publisher = talker.publisher::<Pose>("pose").unwrap();
    let error = domain
        .node("listener")
        .subscriber::<[f32]>("pose")
        .unwrap_err();
    let text = error.to_string();
    let DeclareError::TypeMismatch { ours, theirs, .. } = error else {
        panic!("{text}");
    };
    assert_eq!((ours, theirs), (<[f32]>::type_id(), Pose::type_id()));
    assert!(
        text.contains("f32-list") && text.contains("test/Pose"),
        "{text}"
    );
}

#[test]
fn a_node_can_talk_to_itself() {
    let domain = Domain::new();
    let node = domain.node("alone");
    let subscriber = node.subscriber::<str>("topic").unwrap();
    let publisher = node.publisher::<str>("topic").unwrap();
    publisher.wait_for_subscribers_timeout(1, SOON).unwrap();
    publisher.publish("me").unwrap();
    assert_eq!(&*next(&subscriber), "me");
}

#[test]
fn handles_can_be_used_from_any_thread() {
    fn shared<T: Send + Sync>() {}
    shared::<Node>();
    shared::<Publisher<[u8]>>();
    shared::<Subscriber<str>>();
    shared::<sm2_node::Sample<Pose>>();
    shared::<sm2_node::Loan<'_, Pose>>();
    shared::<sm2_node::Server<str, [f64]>>();
    shared::<sm2_node::Client<str, [f64]>>();
    shared::<sm2_node::Request<str, [f64]>>();
    shared::<sm2_node::Call<[f64]>>();
    shared::<sm2_node::Reply<[f64]>>();
}

#[test]
fn bad_names_and_values_are_errors_that_say_what_to_do() {
    let domain = Domain::new();
    let node = domain.node("node");
    let error = node.publisher::<str>("two words").unwrap_err().to_string();
    assert!(
        error.contains("two words") && error.contains("A-Z"),
        "{error}"
    );
    let error = node
        .subscriber_builder::<str>("a")
        .depth(0)
        .declare()
        .unwrap_err()
        .to_string();
    assert!(error.contains("depth is 0"), "{error}");
    let error = Node::builder("node")
        .socket(domain.socket())
        .connect()
        .unwrap_err()
        .to_string();
    assert!(error.contains("another node"), "{error}");
    let error = Node::builder("a")
        .socket("/nowhere/sm2.sock")
        .connect()
        .unwrap_err()
        .to_string();
    assert!(error.contains("sm2 manager"), "{error}");
    let error = Node::builder("")
        .socket(domain.socket())
        .connect()
        .unwrap_err()
        .to_string();
    assert!(error.contains("empty"), "{error}");
    // A leading slash is accepted.
    node.publisher::<str>("/chatter").unwrap();
    let domain = node.snapshot().unwrap();
    assert_eq!(domain.nodes().count(), 1);
    let left: Vec<_> = domain
        .interfaces()
        .filter(|it| it.refused.is_none())
        .collect();
    assert!(
        left.is_empty(),
        "dropped interfaces are withdrawn: {left:?}"
    );
}

#[test]
fn a_pool_with_a_limit_says_when_it_is_full() {
    let domain = Domain::new();
    let node = domain.node("node");
    let builder = node.publisher_builder::<[u8]>("topic").latched(2);
    let publisher = builder.pool_limit(1 << 20).declare().unwrap();
    publisher.publish(&pattern(300_000, 1)).unwrap();
    publisher.publish(&pattern(300_000, 2)).unwrap();
    let error = publisher
        .publish(&pattern(300_000, 3))
        .unwrap_err()
        .to_string();
    assert!(error.contains("pool_limit"), "{error}");
    // Messages that are held do not change.
    let subscriber = domain.node("late").subscriber::<[u8]>("topic").unwrap();
    meet(&publisher, &[&subscriber]);
    for seed in 1..=2 {
        assert!(*next(&subscriber) == *pattern(300_000, seed));
    }
}
