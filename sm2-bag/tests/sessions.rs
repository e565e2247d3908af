//! Topics beyond the interfaces of a session.
use std::collections::BTreeSet;
use std::os::fd::AsFd;
use std::sync::Mutex;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::thread;
use std::time::Duration;

use sm2_bag::{Bag, Options, PlayOptions, Player, Recorder, Topics};
use sm2_manager::{Limit, Limits};
use sm2_node::{Node, Publisher, Shutdown};
use sm2_test_support::{SOON, until};

use crate::common::Domain;

/// The interfaces of a session.
const ROOM: usize = 2;

/// A domain with three topics more than the recorder's first session has room for.
fn crowded() -> (Domain, Vec<Publisher<u64>>) {
    let interfaces = u32::try_from(ROOM).unwrap();
    let limits = Limits::default().with(Limit::InterfacesPerSession, interfaces);
    let domain = Domain::with(sm2_manager::Options {
        limits,
        ..Default::default()
    });
    let topic = |it: usize| {
        let node = domain.node(&format!("talker/{it}"));
        node.publisher(&format!("topic/{it}")).unwrap()
    };
    let topics = (0..ROOM + 3).map(topic).collect();
    (domain, topics)
}

fn options() -> Options {
    Options {
        sync_interval: Duration::from_millis(1),
        ..Options::new(Topics::All)
    }
}

/// A session that is full already, and keeps its interfaces in `taken`.
fn full(domain: &Domain, number: usize, taken: &Mutex<Vec<Publisher<u64>>>) -> Node {
    let node = domain.node(&format!("full/{number}"));
    for it in 0..ROOM {
        let publisher = node.publisher(&format!("taken/{number}/{it}"));
        taken.lock().unwrap().push(publisher.unwrap());
    }
    node
}

#[test]
fn each_session_has_as_many_topics_as_it_may_have() {
    let (domain, topics) = crowded();
    let (node, shutdown) = (domain.node("recorder"), Shutdown::new().unwrap());
    let storage = domain.create("bag");
    let sessions = AtomicUsize::new(1);
    let mut recorder = Recorder::start(&node, storage, options(), shutdown.as_fd()).unwrap();
    recorder.connect_with(|| {
        let number = sessions.fetch_add(1, Ordering::SeqCst) + 1;
        Ok(domain.node(&format!("recorder/{number}")))
    });
    until("all topics are linked", || {
        recorder.step(Duration::from_millis(1)).unwrap();
        let is_linked = |it: &Publisher<u64>| it.links().iter().any(|link| link.open);
        topics.iter().all(is_linked)
    });
    let report = recorder.finish().unwrap();
    assert_eq!((sessions.into_inner(), report.not_recorded), (3, 0));
}

/// A further session that is of no use is not tried again and again.
#[test]
fn a_session_without_room_for_a_topic_is_the_last_one() {
    let (domain, topics) = crowded();
    let (node, shutdown) = (domain.node("recorder"), Shutdown::new().unwrap());
    let storage = domain.create("bag");
    let (sessions, taken) = (AtomicUsize::new(0), Mutex::default());
    let mut recorder = Recorder::start(&node, storage, options(), shutdown.as_fd()).unwrap();
    recorder.connect_with(|| {
        let number = sessions.fetch_add(1, Ordering::SeqCst);
        Ok(full(&domain, number, &taken))
    });
    until("the other topics are missing", || {
        recorder.step(Duration::from_millis(1)).unwrap();
        recorder.progress().missing >= topics.len() - ROOM
    });
    for _ in 0..50 {
        recorder.step(Duration::from_millis(2)).unwrap();
    }
    let report = recorder.finish().unwrap();
    assert_eq!(sessions.into_inner(), 1);
    assert!(
        report
            .missing
            .iter()
            .all(|it| it.reason.contains("interfaces")),
        "{report:?}"
    );
}

/// Each node of a replay is a session, and a process may have a few hundred of them.
#[test]
fn one_node_plays_for_very_many() {
    let domain = Domain::new();
    let talker = |it: u64| {
        let node = domain.node(&format!("talker/{it}"));
        let numbers = node.publisher_builder::<u64>("numbers");
        numbers.reliable(true).declare().unwrap()
    };
    let talkers: Vec<_> = (0..70).map(talker).collect();
    let (node, stop) = (domain.node("recorder"), Shutdown::new().unwrap());
    let storage = domain.create("bag");
    let mut recorder = Recorder::start(&node, storage, options(), stop.as_fd()).unwrap();
    until("all publishers are linked", || {
        recorder.step(Duration::from_millis(1)).unwrap();
        let is_linked = |it: &Publisher<u64>| it.links().iter().any(|link| link.open);
        talkers.iter().all(is_linked)
    });
    for (number, talker) in (0..).zip(&talkers) {
        talker.publish(&number).unwrap();
        until("the number is written", || {
            recorder.step(Duration::from_millis(1)).unwrap();
            recorder.progress().messages > number
        });
    }
    recorder.finish().unwrap();
    drop(talkers);
    let bags = [Bag::open(&domain.path("bag")).unwrap()];
    let listener = domain.node("listener").subscriber_builder::<u64>("numbers");
    let listener = listener.reliable(true).depth(128).declare().unwrap();
    for (original_names, merged) in [(false, Some(70)), (true, None)] {
        let options = PlayOptions {
            rate: 0.0,
            original_names,
            ..PlayOptions::default()
        };
        let names = Mutex::new(BTreeSet::new());
        let connect = |name: &str| {
            names.lock().unwrap().insert(name.to_owned());
            Ok(domain.node(name))
        };
        let mut player = Player::new(&bags, options, connect, stop.as_fd()).unwrap();
        assert_eq!(player.merged_nodes(), merged);
        thread::scope(|scope| {
            scope.spawn(|| {
                let received = (0..70).map(|_| *listener.recv_timeout(SOON).unwrap().unwrap());
                assert_eq!(received.collect::<BTreeSet<_>>(), (0..70).collect());
            });
            assert!(player.play().unwrap().complete);
        });
        let names = names.into_inner().unwrap();
        match merged {
            Some(_) => assert_eq!(names, BTreeSet::from(["play/bag".to_owned()])),
            None => assert_eq!(names.len(), 70),
        }
    }
}

/// A program may start a recorder in one thread and step it in another.
#[test]
fn a_recorder_can_change_its_thread() {
    const fn is_send<T: Send>() {}
    is_send::<Recorder<'_>>();
}
