//! Topics beyond the interfaces of a session.

use std::os::fd::AsFd;
use std::sync::Mutex;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::Duration;

use sm2_bag::{Options, Recorder, Topics};
use sm2_manager::Policy;
use sm2_node::{Node, Publisher, Shutdown};
use sm2_test_support::until;

use crate::common::Domain;

/// The interfaces of a session.
const ROOM: usize = 2;

/// A domain with three topics more than the recorder's first session has room for.
fn crowded() -> (Domain, Vec<Publisher<u64>>) {
    let policy = Policy {
        interfaces_per_session: ROOM,
        ..Policy::default()
    };
    let domain = Domain::with(sm2_manager::Options {
        policy,
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

/// A program may start a recorder in one thread and step it in another.
#[test]
fn a_recorder_can_change_its_thread() {
    const fn is_send<T: Send>() {}
    is_send::<Recorder<'_>>();
}
