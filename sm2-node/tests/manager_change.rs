//! A node and a change of its Manager: what continues without a Manager, and what the next one learns.

use std::sync::mpsc;
use std::thread;
use std::time::Duration;

use crate::common::{Domain, SOON, away, back, default_pair, meet, next, pattern, until};
use sm2_node::{CallError, ConnectError, DeclareError, Node, Publisher, Subscriber, WaitError};

/// A publisher, and a subscriber whose samples carry numbers.
struct Stream {
    talker: Node,
    listener: Node,
    publisher: Publisher<u64>,
    subscriber: Subscriber<u64>,
    published: u64,
    received: u64,
}

impl Stream {
    fn new(domain: &Domain) -> Self {
        Self::between(domain.node("talker"), domain.node("listener"))
    }

    /// A stream whose nodes look for the next Manager only while they are called.
    fn without_threads(domain: &Domain) -> Self {
        let node = |name| {
            let builder = domain.builder(name);
            builder.background(false).connect().unwrap()
        };
        Self::between(node("talker"), node("listener"))
    }

    fn between(talker: Node, listener: Node) -> Self {
        let builder = talker
            .publisher_builder("numbers")
            .reliable(true)
            .publish_timeout(SOON);
        let publisher = builder.declare().unwrap();
        let builder = listener.subscriber_builder("numbers").reliable(true);
        let subscriber = builder.declare().unwrap();
        meet(&publisher, &[&subscriber]);
        Self {
            talker,
            listener,
            publisher,
            subscriber,
            published: 0,
            received: 0,
        }
    }

    fn publish(&mut self, messages: u64) {
        for _ in 0..messages {
            self.published += 1;
            let published = self.publisher.publish(&self.published).unwrap();
            assert_eq!(published.complete().unwrap().links, 1);
        }
    }

    /// Checks that no message is lost and none arrives twice.
    fn receive(&mut self) {
        while self.received < self.published {
            self.received += 1;
            assert_eq!(*next(&self.subscriber), self.received);
        }
        assert!(self.subscriber.try_recv().unwrap().is_none());
        assert_eq!(self.subscriber.lost(), 0);
    }

    fn nodes(&self) -> [&Node; 2] {
        [&self.talker, &self.listener]
    }

    /// Checks that the link is still the same.
    fn is_the_same(&self) {
        for links in [self.publisher.links(), self.subscriber.links()] {
            assert_eq!(links.len(), 1, "{links:?}");
            assert!(links[0].open && links[0].end.is_none());
        }
    }
}

//= SM2-NOD-003, SM2-RES-001 test
#[test]
fn links_go_on_without_a_manager_and_are_known_to_the_next_one() {
    let mut domain = Domain::new();
    let mut stream = Stream::new(&domain);
    let link = stream.publisher.links()[0].id;
    let epoch = stream.talker.epoch().unwrap();
    for round in 1..=2 {
        // A message in flight when the Manager ends still arrives.
        stream.publish(4);
        domain.stop();
        stream.publish(4);
        away(&stream.nodes());
        stream.receive();
        assert_eq!(stream.talker.epoch(), None);
        assert_eq!(stream.talker.id(), None);
        assert!(!stream.publisher.is_registered());
        stream.publish(4);
        domain.start();
        back(&stream.nodes());
        assert_ne!(stream.talker.epoch().unwrap(), epoch, "round {round}");
        assert!(stream.publisher.is_registered() && stream.subscriber.is_registered());
        stream.publish(4);
        stream.receive();
        stream.is_the_same();
        assert_eq!(stream.publisher.links()[0].id, link);
        // The link is adopted when the Manager has heard both ends, and no other link is made.
        until(|| {
            let snapshot = stream.talker.snapshot().unwrap();
            let known: Vec<_> = snapshot.links().map(|link| link.link).collect();
            assert!(known.iter().all(|it| *it == link), "{known:?}");
            known.len() == 1
        });
    }
}

#[test]
fn new_interfaces_are_linked_with_those_from_before_the_change() {
    let mut domain = Domain::new();
    let mut stream = Stream::new(&domain);
    let latched = stream.talker.publisher_builder::<str>("map").latched(1);
    let latched = latched.declare().unwrap();
    latched.publish("here").unwrap();
    domain.stop();
    away(&stream.nodes());
    domain.start();
    back(&stream.nodes());
    let late = domain.node("late");
    let numbers = late.subscriber::<u64>("numbers").unwrap();
    let map = late.subscriber::<str>("map").unwrap();
    // A new subscriber of a node that existed before the change.
    let old = stream.listener.subscriber::<str>("map").unwrap();
    assert_eq!((numbers.matched(), map.matched(), old.matched()), (1, 1, 1));
    meet(&latched, &[&map, &old]);
    for subscriber in [&map, &old] {
        assert_eq!(&*next(subscriber), "here");
    }
    until(|| {
        let linked = stream.publisher.links().iter().filter(|it| it.open).count() == 2;
        linked & numbers.links().iter().any(|it| it.open)
    });
    stream.published += 1;
    stream.publisher.publish(&stream.published).unwrap();
    assert_eq!(*next(&numbers), stream.published);
    stream.receive();
}

#[test]
fn a_call_in_flight_survives_the_change() {
    let mut domain = Domain::new();
    let server_node = domain.node("server");
    let server = server_node.server::<u64, u64>("double").unwrap();
    let client_node = domain.node("client");
    let client = client_node.client::<u64, u64>("double").unwrap();
    let answer = thread::spawn(move || {
        let request = server.recv_timeout(SOON).unwrap().unwrap();
        domain.stop();
        away(&[&server_node]);
        domain.start();
        let number = *request;
        request.reply(&(2 * number)).unwrap();
        let request = server.recv_timeout(SOON).unwrap().unwrap();
        let number = *request;
        request.reply(&(2 * number)).unwrap();
        back(&[&server_node]);
        domain
    });
    client.wait_for_servers_timeout(1, SOON).unwrap();
    assert_eq!(*client.call_timeout(&21, SOON).unwrap(), 42);
    assert_eq!(*client.call_timeout(&4, SOON).unwrap(), 8);
    let domain = answer.join().unwrap();
    // The server has ended by now, and the new Manager knows that.
    until(|| {
        matches!(
            client.call_timeout(&1, SOON),
            Err(CallError::NoServer { .. } | CallError::ServerGone { .. })
        )
    });
    client_node.wait_connected_timeout(SOON).unwrap();
    drop(domain);
}

//= SM2-RES-002 test
#[test]
fn what_is_declared_without_a_manager_waits_for_the_next_one() {
    let mut domain = Domain::new();
    let node = domain.node("node");
    let other = domain.node("other");
    let publisher = other.publisher::<str>("topic").unwrap();
    domain.stop();
    away(&[&node, &other]);
    thread::scope(|scope| {
        let declared = scope.spawn(|| node.subscriber::<str>("topic").unwrap());
        // The other thread may or may not be waiting yet: both cases must work.
        thread::sleep(Duration::from_millis(20));
        domain.start();
        let subscriber = declared.join().unwrap();
        meet(&publisher, &[&subscriber]);
        publisher.publish("hello").unwrap();
        assert_eq!(&*next(&subscriber), "hello");
    });
}

/// The time limit of calls when no Manager comes.
const VAIN: Duration = Duration::from_millis(if cfg!(feature = "slow") { 400 } else { 100 });

#[test]
fn what_is_declared_in_vain_is_withdrawn() {
    let mut domain = Domain::new();
    // The time limit is for the calls that no Manager answers. On a busy machine, others may need more than one try.
    let connect = || {
        let builder = domain.builder("node");
        let node = builder.manager_timeout(VAIN).connect().ok()?;
        let publisher = node.publisher::<u8>("kept").ok()?;
        Some((node, publisher))
    };
    let mut connected = None;
    until(|| {
        connected = connect();
        connected.is_some()
    });
    let (node, publisher) = connected.unwrap();
    domain.stop();
    away(&[&node]);
    let error = node.publisher::<str>("x").unwrap_err();
    assert!(matches!(error, DeclareError::ManagerGone { .. }), "{error}");
    assert!(error.to_string().contains("sm2 manager"), "{error}");
    let error = node.snapshot().unwrap_err().to_string();
    assert!(error.contains("sm2 manager"), "{error}");
    let wait = Duration::from_millis(1);
    let error = publisher.wait_for_subscribers_timeout(1, wait).unwrap_err();
    assert!(
        matches!(error, WaitError::ManagerGone { found: 0, .. }),
        "{error}"
    );
    let error = node.wait_connected_timeout(wait).unwrap_err();
    assert!(
        matches!(error, WaitError::NoManager { end: Some(_) }),
        "{error}"
    );
    // A subscriber without links waits; it returns no error.
    assert!(!node.is_connected());
    domain.start();
    until(|| node.is_connected());
    let tool = domain.node("tool");
    until(|| {
        // Drives the node.
        node.spin_some().unwrap();
        tool.snapshot().unwrap().nodes().all(|it| !it.resuming)
    });
    let snapshot = tool.snapshot().unwrap();
    let names: Vec<_> = snapshot
        .interfaces()
        .map(|it| it.contract.name().to_string())
        .collect();
    assert_eq!(names, ["kept"]);
}

#[test]
fn a_handle_that_is_dropped_without_a_manager_is_gone_for_the_next_one() {
    let mut domain = Domain::new();
    let (talker, listener) = (domain.node("talker"), domain.node("listener"));
    let gone = talker.publisher::<u8>("gone").unwrap();
    let subscriber = listener.subscriber::<u8>("gone").unwrap();
    let kept = talker.publisher::<u8>("kept").unwrap();
    meet(&gone, &[&subscriber]);
    domain.stop();
    away(&[&talker, &listener]);
    gone.publish(&7).unwrap();
    drop(gone);
    assert_eq!(*next(&subscriber), 7, "what was sent before arrives");
    until(|| subscriber.links()[0].end.is_some());
    domain.start();
    back(&[&talker, &listener]);
    let snapshot = talker.snapshot().unwrap();
    assert_eq!(snapshot.interfaces_of(talker.id().unwrap()).count(), 1);
    // The other end of the link noticed its end while there was no Manager.
    let snapshot = listener.snapshot().unwrap();
    assert_eq!(
        snapshot.links().count() + snapshot.claims().count(),
        0,
        "{snapshot:?}"
    );
    // Both ends can get new counterparts.
    let again = talker.publisher::<u8>("gone").unwrap();
    until(|| again.links().iter().any(|it| it.open) & subscriber.links().iter().any(|it| it.open));
    drop(kept);
}

//= SM2-RES-001 test
#[test]
fn a_node_whose_name_was_taken_meanwhile_goes_on_trying() {
    let mut domain = Domain::new();
    let mut stream = Stream::without_threads(&domain);
    domain.stop();
    away(&stream.nodes());
    domain.start();
    // Before the node that had the name, which is only called below.
    let thief = domain.node("talker");
    back(&[&stream.listener]);
    for _ in 0..20 {
        assert!(!stream.talker.is_connected());
        stream.publish(1);
        stream.receive();
        stream
            .talker
            .spin_once_timeout(Duration::from_millis(5))
            .unwrap();
    }
    drop(thief);
    back(&stream.nodes());
    stream.publish(1);
    stream.receive();
}

//= SM2-RES-010 test
#[test]
fn an_interface_that_the_next_manager_refuses_keeps_its_links() {
    let mut domain = Domain::new();
    let mut stream = Stream::without_threads(&domain);
    domain.stop();
    away(&stream.nodes());
    domain.start();
    let other = domain.node("other");
    let usurper = other.publisher::<str>("numbers").unwrap();
    back(&stream.nodes());
    assert!(!stream.publisher.is_registered() && !stream.subscriber.is_registered());
    stream.publish(5);
    stream.receive();
    stream.is_the_same();
    // Every node can ask for the reason.
    let id = stream.talker.id().unwrap();
    let snapshot = other.snapshot().unwrap();
    let refused: Vec<_> = snapshot.interfaces_of(id).collect();
    assert!(
        refused.len() == 1 && refused[0].refused.is_some(),
        "{refused:?}"
    );
    // The next Manager may have room for it.
    drop(usurper);
    domain.stop();
    away(&stream.nodes());
    domain.start();
    back(&stream.nodes());
    assert!(stream.publisher.is_registered() && stream.subscriber.is_registered());
    stream.publish(5);
    stream.receive();
    stream.is_the_same();
    until(|| stream.talker.snapshot().unwrap().links().count() == 1);
}

#[test]
fn a_receiver_without_links_waits_for_the_next_manager() {
    let mut domain = Domain::new();
    let listener = domain.node("listener");
    let subscriber = listener.subscriber::<str>("topic").unwrap();
    domain.stop();
    away(&[&listener]);
    let nothing = subscriber.recv_timeout(Duration::from_millis(5)).unwrap();
    assert!(nothing.is_none());
    let (started, start) = mpsc::channel();
    thread::scope(|scope| {
        let received = scope.spawn(move || {
            started.send(()).unwrap();
            subscriber.recv().unwrap().to_string()
        });
        start.recv_timeout(SOON).unwrap();
        domain.start();
        let publisher = domain.node("talker").publisher::<str>("topic").unwrap();
        publisher.wait_for_subscribers_timeout(1, SOON).unwrap();
        publisher.publish("at last").unwrap();
        assert_eq!(received.join().unwrap(), "at last");
    });
}

#[test]
fn the_node_s_descriptor_wakes_who_only_waits_for_it() {
    use std::os::fd::AsFd;
    let mut domain = Domain::new();
    let builder = domain.builder("node");
    let node = builder.background(false).connect().unwrap();
    domain.stop();
    until(|| {
        sm2_io::wait_readable(&[node.as_fd()], Some(SOON)).unwrap();
        node.spin_some().unwrap();
        !node.is_connected()
    });
    domain.start();
    // Each call follows a readable descriptor.
    loop {
        assert!(sm2_io::wait_readable(&[node.as_fd()], Some(SOON)).unwrap());
        node.spin_some().unwrap();
        if node.is_connected() {
            break;
        }
    }
}

#[test]
fn many_messages_of_every_form_cross_the_change() {
    let mut domain = Domain::new();
    let (publisher, subscriber) = default_pair(&domain);
    for round in 0..3 {
        domain.stop();
        for seed in 0..20 {
            for len in [16, 5_000, 200_000] {
                publisher.publish(&pattern(len, seed)).unwrap();
                assert!(*next(&subscriber) == *pattern(len, seed), "round {round}");
            }
        }
        domain.start();
        until(|| publisher.is_registered() & subscriber.is_registered());
    }
    assert_eq!(subscriber.lost(), 0);
    assert_eq!(
        publisher.counters().delivered,
        subscriber.links()[0].received.messages
    );
}

#[test]
fn a_node_can_wait_for_a_manager_to_start() {
    let mut domain = Domain::new();
    domain.stop();
    let error = Node::builder("node")
        .socket(domain.socket())
        .connect()
        .unwrap_err();
    assert!(matches!(error, ConnectError::NoManager { .. }), "{error}");
    let socket = domain.socket();
    let waiting = thread::spawn(move || {
        let builder = Node::builder("node").socket(socket);
        builder.startup_timeout(SOON).connect()
    });
    thread::sleep(Duration::from_millis(20));
    domain.start();
    assert!(waiting.join().unwrap().unwrap().is_connected());
}

#[test]
fn a_socket_that_nobody_listens_at_is_tried_for_a_moment() {
    let mut domain = Domain::new();
    domain.stop();
    // The socket file of a Manager that was killed.
    drop(sm2_io::Listener::bind(&domain.socket(), 1).unwrap());
    assert!(domain.socket().exists());
    let error = Node::builder("node")
        .socket(domain.socket())
        .connect()
        .unwrap_err();
    assert!(matches!(error, ConnectError::NoManager { .. }), "{error}");
    let socket = domain.socket();
    let waiting = thread::spawn(move || {
        // The next Manager may need longer on a busy machine: try as often as it takes.
        loop {
            match Node::builder("node").socket(&socket).connect() {
                Err(ConnectError::NoManager { .. }) => {}
                connected => break connected,
            }
        }
    });
    domain.start();
    assert!(waiting.join().unwrap().unwrap().is_connected());
}
