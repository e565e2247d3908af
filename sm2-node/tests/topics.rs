//! Topics, with a real Manager, all in one process.

mod common;

use std::sync::mpsc;
use std::thread;
use std::time::{Duration, Instant};

use common::{Domain, SOON, pattern};
use sm2_node::zerocopy::{FromBytes, Immutable, IntoBytes, KnownLayout};
use sm2_node::{
    DeclareError, LinkStatus, Message, Node, Publisher, RecvError, Subscriber, WaitError,
};

#[derive(Message, FromBytes, IntoBytes, Immutable, KnownLayout, Clone, Copy, Debug, PartialEq)]
#[message(name = "test/Pose")]
#[repr(C)]
struct Pose {
    stamp: u64,
    position: [f64; 3],
}

/// A publisher and a subscriber of two nodes, linked.
fn pair<T: Message + ?Sized>(
    domain: &Domain,
    publisher: impl FnOnce(&Node) -> Publisher<T>,
    subscriber: impl FnOnce(&Node) -> Subscriber<T>,
) -> (Publisher<T>, Subscriber<T>) {
    let publisher = publisher(&domain.node("talker"));
    let subscriber = subscriber(&domain.node("listener"));
    assert_eq!(subscriber.matched(), 1);
    meet(&publisher, &[&subscriber]);
    (publisher, subscriber)
}

/// One end of a topic, whatever its type.
trait Endpoint {
    fn links(&self) -> Vec<LinkStatus>;
}

impl<T: Message + ?Sized> Endpoint for Publisher<T> {
    fn links(&self) -> Vec<LinkStatus> {
        Publisher::links(self)
    }
}

impl<T: Message + ?Sized> Endpoint for Subscriber<T> {
    fn links(&self) -> Vec<LinkStatus> {
        Subscriber::links(self)
    }
}

/// Several nodes in one thread: each has to be called until all their links are open.
fn meet(publisher: &dyn Endpoint, subscribers: &[&dyn Endpoint]) {
    let deadline = Instant::now() + SOON;
    let open = |end: &dyn Endpoint| end.links().iter().filter(|link| link.open).count();
    loop {
        let counts: Vec<_> = subscribers.iter().map(|it| open(*it)).collect();
        if open(publisher) == subscribers.len() && counts.iter().all(|&count| count == 1) {
            return;
        }
        assert!(Instant::now() < deadline, "a link did not open");
        thread::sleep(Duration::from_micros(100));
    }
}

fn default_pair(domain: &Domain) -> (Publisher<[u8]>, Subscriber<[u8]>) {
    pair(
        domain,
        |node| node.publisher("topic").unwrap(),
        |node| node.subscriber("topic").unwrap(),
    )
}

fn next<T: Message + ?Sized>(subscriber: &Subscriber<T>) -> sm2_node::Sample<T> {
    subscriber.recv_timeout(SOON).unwrap().expect("a message")
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
    publisher.wait_for_subscribers(1, Some(SOON)).unwrap();
    publisher.publish("me").unwrap();
    assert_eq!(&*next(&subscriber), "me");
}

//= SM2-QOS-003 test
#[test]
fn late_subscribers_get_what_is_latched_first() {
    let domain = Domain::new();
    let node = domain.node("map");
    for (topic, inline_max, reliable) in [
        ("small", 61_440, false),
        ("large", 0, false),
        ("all", 0, true),
    ] {
        let builder = node
            .publisher_builder::<[u8]>(topic)
            .latched(3)
            .inline_max(inline_max);
        let publisher = builder.reliable(SOON).declare().unwrap();
        for seed in 1..=5 {
            assert_eq!(publisher.publish(&pattern(6000, seed)).unwrap().links, 0);
        }
        for (late, sealed) in [("one", false), ("two", true)] {
            // A reliable one whose window is smaller than what is latched.
            let builder = domain
                .node(late)
                .subscriber_builder::<[u8]>(topic)
                .sealed(sealed);
            let depth = if reliable { 1 } else { 8 };
            let builder = builder.depth(depth).max_borrowed(1).reliable(reliable);
            let subscriber = builder.declare().unwrap();
            meet(&publisher, &[&subscriber]);
            if !reliable {
                publisher.publish(&pattern(6000, 6)).unwrap();
            }
            let latest = if reliable { 3..=5 } else { 3..=6 };
            for seed in latest.skip(usize::from(!reliable && late == "two")) {
                publisher_is_driven(&node);
                let sample = take_while_driving(&subscriber, &node);
                assert!(*sample == *pattern(6000, seed), "{topic} {late} {seed}");
            }
        }
    }
}

fn publisher_is_driven(node: &Node) {
    node.spin_once(None).unwrap();
}

/// Receives while another node of this thread is called as well.
fn take_while_driving(subscriber: &Subscriber<[u8]>, node: &Node) -> sm2_node::Sample<[u8]> {
    let deadline = Instant::now() + SOON;
    loop {
        if let Some(sample) = subscriber.recv_timeout(Duration::from_millis(1)).unwrap() {
            return sample;
        }
        node.spin_once(None).unwrap();
        assert!(Instant::now() < deadline, "no message");
    }
}

//= SM2-QOS-001 test
//= SM2-QOS-004 test
#[test]
fn a_subscriber_that_never_reads_costs_only_itself_and_every_loss_is_counted() {
    let domain = Domain::new();
    let (publisher, reader) = default_pair(&domain);
    let sleeper = domain.node("sleeper");
    let asleep = sleeper.subscriber::<[u8]>("topic").unwrap();
    meet(&publisher, &[&reader, &asleep]);
    let rounds = 200;
    let start = Instant::now();
    for seed in 0..rounds {
        let bytes = pattern(10_000, seed);
        assert_eq!(publisher.publish(&bytes).unwrap().links, 2);
        let sample = next(&reader);
        assert!(*sample == *bytes);
        assert_eq!(sample.lost(), 0);
    }
    assert!(start.elapsed() < SOON);
    assert!(!publisher.flush(Duration::from_millis(20)).unwrap());
    let links = publisher.links();
    for link in &links {
        let it = link.counters;
        let sum =
            it.delivered + it.overwritten + it.discarded + it.deadline + it.closed + it.in_flight;
        assert_eq!(it.offered, sum);
        assert_eq!(it.offered, rounds);
    }
    assert_eq!(links[0].counters.delivered, rounds);
    // What its window admits is on its way, as much waits here, and the rest is lost.
    let lost = links[1].counters.overwritten;
    assert_eq!(links[1].counters.in_flight, 8 + 4 + 8);
    assert_eq!(lost, rounds - (8 + 4 + 8));
    assert_eq!(publisher.counters().offered, 2 * rounds);
    // The pool is as large as these need, and no larger.
    assert!(
        publisher.pool_bytes() <= 64 * (16 << 10),
        "{}",
        publisher.pool_bytes()
    );

    // When it wakes up, it gets the newest ones, and knows how many it lost.
    let mut seen = Vec::new();
    while let Some(sample) = asleep.recv_timeout(Duration::from_millis(50)).unwrap() {
        assert!(*sample == *pattern(10_000, sample.sequence() - 1));
        seen.push(sample.sequence());
        drop(sample);
        publisher.counters();
    }
    assert_eq!(*seen.last().unwrap(), rounds);
    assert_eq!(asleep.lost() + seen.len() as u64, rounds);
}

//= SM2-QOS-002 test
#[test]
fn a_reliable_publisher_waits_until_its_deadline_for_each_link_alone() {
    let domain = Domain::new();
    let patience = Duration::from_millis(100);
    let publisher = domain.node("talker");
    let publisher = publisher
        .publisher_builder::<[u8]>("topic")
        .depth(1)
        .reliable(patience);
    let publisher = publisher.declare().unwrap();
    let stalled = domain
        .node("stalled")
        .subscriber_builder::<[u8]>("topic")
        .depth(1)
        .max_borrowed(1);
    let stalled = stalled.reliable(true).declare().unwrap();
    let best_effort = domain
        .node("best-effort")
        .subscriber::<[u8]>("topic")
        .unwrap();
    meet(&publisher, &[&stalled, &best_effort]);
    // Two in the window, one in the queue.
    for _ in 0..3 {
        let published = publisher.publish(b"x").unwrap();
        assert_eq!((published.links, published.missed), (2, 0));
    }
    let start = Instant::now();
    let published = publisher.publish(b"late").unwrap();
    assert!(start.elapsed() >= patience);
    assert_eq!((published.links, published.missed), (1, 1));
    assert!(published.complete().is_err());
    // Not waited for again.
    let start = Instant::now();
    assert_eq!(publisher.publish(b"later").unwrap().missed, 1);
    assert!(start.elapsed() < patience);
    for expected in [&b"x"[..], b"x", b"x", b"late", b"later"] {
        assert_eq!(&*next(&best_effort), expected);
    }
    // Until it releases something.
    assert_eq!(&*next(&stalled), b"x");
    assert_eq!(publisher.publish(b"again").unwrap().missed, 0);
    let counters = publisher.links()[0].counters;
    assert_eq!((counters.offered, counters.deadline), (6, 2));
    for expected in [&b"x"[..], b"x", b"again"] {
        assert_eq!(&*next(&stalled), expected);
        publisher.counters();
    }
    assert_eq!(stalled.lost(), 2);
}

#[test]
fn nothing_is_lost_on_a_reliable_link_with_a_slow_reader() {
    let domain = Domain::new();
    let (publisher, subscriber) = pair::<[u8]>(
        &domain,
        |node| {
            node.publisher_builder("topic")
                .depth(2)
                .reliable(SOON)
                .declare()
                .unwrap()
        },
        |node| {
            let builder = node.subscriber_builder("topic").depth(2).max_borrowed(2);
            builder.reliable(true).declare().unwrap()
        },
    );
    let reader = thread::spawn(move || {
        for seed in 0..100 {
            let sample = next(&subscriber);
            assert!(*sample == *pattern(5000, seed));
            if seed % 10 == 0 {
                thread::sleep(Duration::from_millis(2));
            }
        }
        assert_eq!(subscriber.lost(), 0);
    });
    for seed in 0..100 {
        publisher
            .publish(&pattern(5000, seed))
            .unwrap()
            .complete()
            .unwrap();
    }
    assert!(publisher.flush(SOON).unwrap());
    reader.join().unwrap();
}

//= SM2-MSG-005 test
#[test]
fn whoever_holds_too_many_samples_gets_no_more_and_is_told_so() {
    let domain = Domain::new();
    let (publisher, subscriber) = default_pair(&domain);
    let mut held = Vec::new();
    for seed in 0..6 {
        publisher.publish(&pattern(5000, seed)).unwrap();
    }
    for _ in 0..4 {
        held.push(next(&subscriber));
    }
    let error = subscriber.try_recv().unwrap_err();
    assert!(
        matches!(error, RecvError::TooManyBorrowed { held: 4, .. }),
        "{error}"
    );
    held.remove(0);
    assert!(*next(&subscriber) == *pattern(5000, 4));
    for (sample, seed) in held.iter().zip(1..) {
        assert!(**sample == *pattern(5000, seed));
    }
}

#[test]
fn a_sample_stays_as_it_is_when_all_else_is_gone() {
    let domain = Domain::new();
    for sealed in [false, true] {
        let (publisher, subscriber) = pair::<[u8]>(
            &domain,
            |node| {
                node.publisher_builder("topic")
                    .sealed(sealed)
                    .declare()
                    .unwrap()
            },
            |node| node.subscriber("topic").unwrap(),
        );
        publisher.publish(&pattern(50_000, 1)).unwrap();
        publisher.publish(&pattern(50_000, 2)).unwrap();
        let sample = next(&subscriber);
        // The second is neither taken nor given back.
        drop(subscriber);
        // The publisher would use its slot again, if it thought it free.
        for seed in 3..40 {
            publisher.publish(&pattern(50_000, seed)).unwrap();
        }
        assert!(*sample == *pattern(50_000, 1));
        let again = domain
            .node("listener-2")
            .subscriber::<[u8]>("topic")
            .unwrap();
        meet(&publisher, &[&again]);
        for seed in 40..80 {
            publisher.publish(&pattern(50_000, seed)).unwrap();
            assert!(*next(&again) == *pattern(50_000, seed));
        }
        assert!(*sample == *pattern(50_000, 1));
        drop(publisher);
        assert!(*sample == *pattern(50_000, 1));
    }
}

//= SM2-TRN-006 test
//= SM2-OPN-005 test
#[test]
fn what_was_sent_before_the_publisher_went_is_received() {
    let domain = Domain::new();
    for (sealed, inline_max) in [(false, 61_440), (false, 0), (true, 0)] {
        let (publisher, subscriber) = pair::<[u8]>(
            &domain,
            |node| {
                let builder = node.publisher_builder("topic").sealed(sealed);
                builder.inline_max(inline_max).declare().unwrap()
            },
            |node| node.subscriber("topic").unwrap(),
        );
        for seed in 0..8 {
            publisher.publish(&pattern(5000, seed)).unwrap();
        }
        drop(publisher);
        // Let the Manager's word arrive before the link is read.
        thread::sleep(Duration::from_millis(20));
        for seed in 0..8 {
            assert!(*next(&subscriber) == *pattern(5000, seed), "{seed}");
        }
        assert!(subscriber.try_recv().unwrap().is_none());
        assert_eq!(subscriber.lost(), 0);
    }
}

#[test]
fn two_threads_of_one_node_both_get_their_messages() {
    let domain = Domain::new();
    let talker = domain.node("talker");
    let listener = domain.node("listener");
    let topics = ["a", "b", "c"];
    let publishers: Vec<_> = topics
        .iter()
        .map(|topic| {
            talker
                .publisher_builder::<[u8]>(topic)
                .reliable(SOON)
                .declare()
                .unwrap()
        })
        .collect();
    let (ready, opened) = mpsc::channel();
    let readers: Vec<_> = topics
        .iter()
        .map(|topic| {
            let builder = listener.subscriber_builder::<[u8]>(topic).reliable(true);
            let subscriber = builder.declare().unwrap();
            let ready = ready.clone();
            thread::spawn(move || {
                subscriber.wait_for_publishers(1, Some(SOON)).unwrap();
                ready.send(()).unwrap();
                for seed in 0..300 {
                    assert!(*next(&subscriber) == *pattern(16, seed));
                }
            })
        })
        .collect();
    for publisher in &publishers {
        publisher.wait_for_subscribers(1, Some(SOON)).unwrap();
    }
    for _ in topics {
        opened.recv_timeout(SOON).unwrap();
    }
    for seed in 0..300 {
        for publisher in &publishers {
            publisher
                .publish(&pattern(16, seed))
                .unwrap()
                .complete()
                .unwrap();
        }
        if seed % 50 == 0 {
            // Let them all fall asleep.
            thread::sleep(Duration::from_millis(5));
        }
    }
    // What still waits for a window here is sent when this node is called.
    for publisher in &publishers {
        assert!(publisher.flush(SOON).unwrap());
    }
    for reader in readers {
        reader.join().unwrap();
    }
}

#[test]
fn a_descriptor_is_readable_while_there_may_be_a_message() {
    use std::os::fd::AsFd;
    let domain = Domain::new();
    let listener = domain.node("listener");
    let talker = domain.node("talker");
    let publisher = talker.publisher::<str>("a").unwrap();
    let subscriber = listener.subscriber::<str>("a").unwrap();
    meet(&publisher, &[&subscriber]);
    let readable = |timeout| sm2_io::wait_readable(&[subscriber.as_fd()], Some(timeout)).unwrap();
    // At first there may be something: nobody has looked yet.
    assert!(readable(SOON));
    assert!(subscriber.try_recv().unwrap().is_none());
    assert!(!readable(Duration::from_millis(5)));
    publisher.publish("one").unwrap();
    assert!(readable(SOON));
    // Another call reads it from the socket: it is still there for the subscriber.
    listener.spin_once(None).unwrap();
    assert!(readable(SOON));
    assert_eq!(&*subscriber.try_recv().unwrap().unwrap(), "one");
    assert!(subscriber.try_recv().unwrap().is_none());
    assert!(!readable(Duration::from_millis(5)));
}

//= SM2-NOD-003 test
#[test]
fn without_a_manager_links_live_on_and_nothing_new_comes() {
    let mut domain = Domain::new();
    let (publisher, subscriber) = default_pair(&domain);
    let (a, b) = (domain.node("a"), domain.node("b"));
    domain.stop();
    for seed in 0..50 {
        publisher.publish(&pattern(5000, seed)).unwrap();
        assert!(*next(&subscriber) == *pattern(5000, seed));
    }
    let deadline = Instant::now() + SOON;
    while a.is_connected() {
        assert!(Instant::now() < deadline);
    }
    assert!(matches!(
        a.publisher::<str>("x"),
        Err(DeclareError::ManagerGone { .. })
    ));
    let error = publisher.wait_for_subscribers(2, None).unwrap_err();
    assert!(
        matches!(error, WaitError::ManagerGone { found: 1, .. }),
        "{error}"
    );
    drop(publisher);
    let error = loop {
        match subscriber.recv() {
            Ok(_) => {}
            Err(error) => break error,
        }
    };
    assert!(matches!(error, RecvError::Disconnected(_)), "{error}");
    b.spin().unwrap();
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
    // A leading slash is a habit of many.
    node.publisher::<str>("/chatter").unwrap();
    let graph = node.graph(SOON).unwrap();
    assert_eq!(
        graph.items.len(),
        1,
        "what was dropped is withdrawn: {graph:?}"
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
    // Those that are kept are as they were.
    let subscriber = domain.node("late").subscriber::<[u8]>("topic").unwrap();
    meet(&publisher, &[&subscriber]);
    for seed in 1..=2 {
        assert!(*next(&subscriber) == *pattern(300_000, seed));
    }
}
