//! The sources of wait sets: when each kind is reported, and when it is not any more.

use std::io::{Read, Write};
use std::os::unix::net::UnixStream;
use std::time::Duration;

use crate::common::fixture::Fixture;
use crate::common::wait::{LONG, is_quiet, next};
use crate::common::{SOON, meet};
use sm2_node::wait_set::{Cause, Interest, Readiness, Ready};
use sm2_node::{CallError, Instant, MissedTicks, Timer, WaitSet, now};

#[test]
fn a_subscriber_is_ready_until_nothing_is_left() {
    Fixture::each(|it| {
        let subscriber = it.node("listener").subscriber::<u64>("topic").unwrap();
        let publisher = it.peer("talker").publisher::<u64>("topic").unwrap();
        meet(&publisher, &[&subscriber]);
        // Before it is added.
        publisher.publish(&0).unwrap();
        let mut set = WaitSet::new().unwrap();
        let key = set.add(&subscriber, ()).unwrap();
        for round in 0..3 {
            for number in 1..=3 {
                publisher.publish(&(round * 3 + number)).unwrap();
            }
            let last = round * 3 + 3;
            loop {
                assert_eq!(next(&mut set).key, key);
                let sample = subscriber.try_recv().unwrap().expect("a message");
                if *sample == last {
                    break;
                }
            }
            assert!(is_quiet(&mut set));
        }
    });
}

#[test]
fn changes_of_a_domain_are_reported_and_messages_are_not() {
    Fixture::each(|it| {
        let node = it.node("listener");
        let subscriber = node.subscriber::<u64>("topic").unwrap();
        let publisher = it.peer("talker").publisher::<u64>("topic").unwrap();
        meet(&publisher, &[&subscriber]);
        let mut watch = node.watch();
        let mut set = WaitSet::new().unwrap();
        let key = set.add_watch(&mut watch, ()).unwrap();
        let mut has_topic = |watch: &mut sm2_node::domain::Watch, name: &str| loop {
            assert_eq!(next(&mut set).key, key);
            while !watch.try_wait().unwrap().is_empty() {}
            let mut interfaces = watch.domain().interfaces();
            if interfaces.any(|it| it.contract.name().as_str() == name) {
                break is_quiet(&mut set);
            }
        };
        assert!(has_topic(&mut watch, "topic"));
        let _other = it.peer("other").publisher::<u64>("another").unwrap();
        assert!(has_topic(&mut watch, "another"));
        publisher.publish(&1).unwrap();
        assert!(is_quiet(&mut set));
        assert!(subscriber.recv_timeout(LONG).unwrap().is_some());
        assert!(set.remove(key));
        let _third = it.peer("third").publisher::<u64>("third").unwrap();
        assert!(is_quiet(&mut set));
    });
}

#[test]
fn a_source_that_is_removed_while_it_is_ready_is_not_reported() {
    Fixture::each(|it| {
        let node = it.node("listener");
        let subscribers = ["a", "b"].map(|topic| node.subscriber::<u64>(topic).unwrap());
        let talker = it.peer("talker");
        let publishers = ["a", "b"].map(|topic| talker.publisher::<u64>(topic).unwrap());
        let mut set = WaitSet::new().unwrap();
        let keys = [0, 1].map(|at| set.add(&subscribers[at], at).unwrap());
        for (publisher, subscriber) in publishers.iter().zip(&subscribers) {
            meet(publisher, &[subscriber]);
            publisher.publish(&1).unwrap();
        }
        // Both are found together.
        let first = next(&mut set).tag;
        let other = 1 - first;
        assert!(set.remove(keys[other]));
        assert!(!set.remove(keys[other]));
        assert!(subscribers[first].try_recv().unwrap().is_some());
        assert!(is_quiet(&mut set));
        assert_eq!(set.len(), 1);
        // It can come back.
        let again = set.add(&subscribers[other], other).unwrap();
        assert_ne!(again, keys[other]);
        assert_eq!(next(&mut set).tag, other);
        assert!(subscribers[other].try_recv().unwrap().is_some());
    });
}

#[test]
fn a_subscriber_that_was_dropped_is_never_ready() {
    Fixture::each(|it| {
        let subscriber = it.node("listener").subscriber::<u64>("topic").unwrap();
        let publisher = it.peer("talker").publisher::<u64>("topic").unwrap();
        let mut set = WaitSet::new().unwrap();
        let key = set.add(&subscriber, ()).unwrap();
        meet(&publisher, &[&subscriber]);
        publisher.publish(&1).unwrap();
        assert_eq!(next(&mut set).key, key);
        drop(subscriber);
        assert!(is_quiet(&mut set));
        assert!(set.remove(key));
    });
}

#[test]
fn calls_are_reported_once_with_a_reply_a_failure_or_their_deadline() {
    Fixture::each(|it| {
        let server = it.peer("server").server::<u64, u64>("service").unwrap();
        let client = it.node("client").client::<u64, u64>("service").unwrap();
        client.wait_for_servers_timeout(1, SOON).unwrap();
        let mut calls = [1, 2].map(|number| client.send(&number).unwrap());
        let mut late = client.send_timeout(&3, Duration::from_millis(1)).unwrap();
        let forgotten = client.send(&4).unwrap();
        let mut set = WaitSet::new().unwrap();
        for (at, call) in calls.iter().enumerate() {
            set.add(call, at).unwrap();
        }
        set.add(&late, 2).unwrap();
        set.add(&forgotten, 3).unwrap();
        // Nobody has replied.
        assert_eq!(next(&mut set).tag, 2);
        let ended = late.try_wait().map(drop);
        assert!(
            matches!(ended, Err(CallError::DeadlineExceeded { .. })),
            "{ended:?}"
        );
        assert!(is_quiet(&mut set));
        drop(forgotten);
        assert!(is_quiet(&mut set));
        let mut requests = Vec::new();
        while requests.len() < 2 {
            let request = server.recv_timeout(SOON).unwrap().expect("a request");
            if *request <= 2 {
                requests.push(request);
            }
        }
        requests.pop().unwrap().reply(&20).unwrap();
        assert_eq!(next(&mut set).tag, 1);
        assert_eq!(*calls[1].try_wait().unwrap().expect("a reply"), 20);
        assert!(is_quiet(&mut set));
        // The server fails the other call as it ends.
        drop(requests);
        drop(server);
        assert_eq!(next(&mut set).tag, 0);
        assert!(calls[0].try_wait().is_err());
        assert_eq!(set.len(), 1, "only the forgotten call is left");
    });
}

#[test]
fn timers_skip_or_repeat_missed_ticks_and_leave_the_set_after_the_last() {
    // Its fourth tick has passed, and the fifth does not come during this test.
    let long = Duration::from_nanos(now().0 / 4);
    let mut set = WaitSet::new().unwrap();
    set.add_timer(Timer::starting_at(Instant(0), long), "skip");
    let Cause::Tick(tick) = next(&mut set).cause else {
        panic!("not a tick");
    };
    assert_eq!((tick.number, tick.missed), (4, 3));
    assert!(is_quiet(&mut set));
    let burst = Timer::starting_at(Instant(0), long).missed_ticks(MissedTicks::Burst);
    let key = set.add_timer(burst, "burst");
    for number in 1..=4 {
        let Ready { tag, cause, .. } = next(&mut set);
        assert_eq!(tag, "burst");
        assert!(matches!(cause, Cause::Tick(tick) if tick.number == number));
    }
    assert!(is_quiet(&mut set));
    assert!(set.remove(key));
    set.add_timer(Timer::once(Duration::ZERO), "once");
    assert_eq!(next(&mut set).tag, "once");
    assert_eq!(set.len(), 1);
    assert!(is_quiet(&mut set));
}

#[test]
fn a_wait_ends_after_its_time_without_a_source() {
    let mut set = WaitSet::<()>::new().unwrap();
    assert!(set.is_empty());
    set.add_timer(Timer::every(LONG), ());
    let waited = set.wait_timeout(Duration::from_millis(1)).unwrap();
    assert!(waited.is_none());
}

#[test]
fn descriptors_are_borrowed_or_owned_with_their_interest() {
    let (borrowed, mut peer) = UnixStream::pair().unwrap();
    let (owned, other) = UnixStream::pair().unwrap();
    let mut set = WaitSet::new().unwrap();
    let error = set.add_descriptor(
        std::fs::File::open("Cargo.toml").unwrap(),
        Interest::Readable,
        0,
    );
    assert_eq!(
        error.unwrap_err().kind(),
        std::io::ErrorKind::PermissionDenied
    );
    let key = set
        .add_descriptor(&borrowed, Interest::Readable, 1)
        .unwrap();
    let error = set.add_descriptor(&borrowed, Interest::Readable, 1);
    assert_eq!(error.unwrap_err().kind(), std::io::ErrorKind::AlreadyExists);
    assert!(is_quiet(&mut set));
    let writable = set.add_descriptor(owned, Interest::Writable, 2).unwrap();
    // Level-triggered: as long as it is ready.
    for _ in 0..3 {
        let ready = next(&mut set);
        let cause = Cause::Descriptor(Readiness {
            readable: false,
            writable: true,
        });
        assert_eq!((ready.tag, ready.cause), (2, cause));
    }
    assert!(set.remove(writable));
    // The set owned it.
    assert_eq!((&other).read(&mut [0]).unwrap(), 0);
    peer.write_all(&[1]).unwrap();
    assert_eq!(next(&mut set).key, key);
    assert_eq!((&borrowed).read(&mut [0]).unwrap(), 1);
    assert!(is_quiet(&mut set));
    drop(peer);
    assert!(set.remove(key));
    assert!(is_quiet(&mut set));
    let again = set
        .add_descriptor(&borrowed, Interest::Readable, 3)
        .unwrap();
    let ready = next(&mut set);
    assert_eq!((ready.tag, ready.key), (3, again));
    assert!(matches!(
        ready.cause,
        Cause::Descriptor(Readiness { readable: true, .. })
    ));
}
