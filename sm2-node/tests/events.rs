//! Events of publishers, subscribers, servers and clients: with and without the background thread, on both lanes.

use std::time::Duration;

use crate::common::fixture::Fixture;
use crate::common::threads::while_asleep;
use crate::common::{Domain, SOON, meet, until};
use sm2_node::diagnostics::End;
use sm2_node::{Event, Events, Shutdown, WaitError};
use sm2_proto::Farewell;

fn next(events: &Events) -> Event {
    events.next_timeout(SOON).unwrap().expect("an event")
}

fn joins(events: &Events, name: &str) {
    let event = next(events);
    assert!(
        matches!(&event, Event::Joined { peer } if peer.name.as_str() == name),
        "{event:?}"
    );
}

fn leaves(events: &Events, name: &str) {
    let event = next(events);
    let done = Farewell::Done.code();
    let is_left = matches!(&event, Event::Left { peer, end: End::Peer(code) }
        if peer.name.as_str() == name && *code == done);
    assert!(is_left, "{event:?}");
}

fn is_quiet(events: &Events) -> bool {
    events.try_next().unwrap().is_none()
}

#[test]
fn all_four_kinds_see_peers_join_and_leave() {
    Fixture::each(|it| {
        let node = it.node("robot");
        let publisher = node.publisher::<u64>("out").unwrap();
        let subscriber = node.subscriber::<u64>("in").unwrap();
        let server = node.server::<u64, u64>("served").unwrap();
        let client = node.client::<u64, u64>("called").unwrap();
        let all = [
            publisher.events(),
            subscriber.events(),
            server.events(),
            client.events(),
        ];
        for round in 0..2 {
            assert!(all.iter().all(is_quiet), "round {round}");
            // The Manager may not know yet that the last one is gone.
            let name = format!("peer-{round}");
            let peer = it.peer(&name);
            let others = (
                peer.subscriber::<u64>("out").unwrap(),
                peer.publisher::<u64>("in").unwrap(),
                peer.client::<u64, u64>("served").unwrap(),
                peer.server::<u64, u64>("called").unwrap(),
            );
            all.iter().for_each(|events| joins(events, &name));
            drop((others, peer));
            all.iter().for_each(|events| leaves(events, &name));
        }
    });
}

#[test]
fn the_first_events_are_the_links_that_are_open() {
    Fixture::each(|it| {
        let publisher = it.node("talker").publisher::<u64>("topic").unwrap();
        let subscriber = it.peer("listener").subscriber::<u64>("topic").unwrap();
        meet(&publisher, &[&subscriber]);
        let events = publisher.events();
        joins(&events, "listener");
        assert!(is_quiet(&events));
        // Both values share the events: each is taken once.
        let same = publisher.events();
        assert!(is_quiet(&same));
        drop(subscriber);
        leaves(&same, "listener");
        assert!(is_quiet(&events));
    });
}

#[test]
fn losses_are_counted_at_both_ends() {
    Fixture::each(|it| {
        let publisher = it.node("talker").publisher::<u64>("topic").unwrap();
        let listener = it.node("listener");
        let subscriber = listener.subscriber_builder::<u64>("topic").depth(2);
        let subscriber = subscriber.max_borrowed(1).declare().unwrap();
        meet(&publisher, &[&subscriber]);
        let (sent, received) = (publisher.events(), subscriber.events());
        joins(&sent, "listener");
        joins(&received, "talker");
        for number in 1..=100 {
            publisher.publish(&number).unwrap();
        }
        let mut taken = 0;
        until(|| {
            // Drives the publisher's node if it has no thread.
            publisher.links();
            let sample = subscriber.try_recv().unwrap();
            taken += u64::from(sample.is_some());
            sample.is_some_and(|sample| *sample == 100)
        });
        until(|| publisher.counters().in_flight == 0);
        assert!(taken < 100, "a depth of 2 keeps few of them");
        for (events, name) in [(&sent, "listener"), (&received, "talker")] {
            let mut lost = 0;
            while let Some(event) = events.try_next().unwrap() {
                match event {
                    Event::Lost { peer, messages } if peer.name.as_str() == name => {
                        lost += messages
                    }
                    event => panic!("{event:?}"),
                }
            }
            assert_eq!(lost, 100 - taken, "as {name} sees it");
        }
        assert_eq!(subscriber.lost(), 100 - taken);
    });
}

/// Only the publishing thread notices the loss.
#[test]
fn a_loss_wakes_a_thread() {
    Fixture::each(|it| {
        let publisher = it.node("talker").publisher::<u64>("topic").unwrap();
        let listener = it.peer("listener").subscriber_builder::<u64>("topic");
        let subscriber = listener.depth(1).declare().unwrap();
        meet(&publisher, &[&subscriber]);
        let events = publisher.events();
        joins(&events, "listener");
        let event = while_asleep(
            || events.next(),
            |_| {
                for number in 0..200 {
                    publisher.publish(&number).unwrap();
                }
            },
        );
        assert!(matches!(event, Ok(Event::Lost { .. })), "{event:?}");
    });
}

#[test]
fn an_event_wakes_a_thread() {
    Fixture::each(|it| {
        let publisher = it.node("talker").publisher::<u64>("topic").unwrap();
        let events = publisher.events();
        let listener = it.peer("listener");
        let mut subscriber = None;
        let event = while_asleep(
            || events.next(),
            |_| subscriber = Some(listener.subscriber::<u64>("topic").unwrap()),
        );
        assert!(matches!(event, Ok(Event::Joined { .. })), "{event:?}");
        assert!(events.next_timeout(Duration::ZERO).unwrap().is_none());
    });
}

#[test]
fn a_shutdown_ends_the_wait_for_an_event() {
    let domain = Domain::new();
    let shutdown = Shutdown::new().unwrap();
    let builder = domain.builder("talker");
    let node = builder.shutdown(&shutdown).connect().unwrap();
    let events = node.publisher::<u64>("topic").unwrap().events();
    let ended = while_asleep(|| events.next(), |_| shutdown.request());
    assert!(matches!(ended, Err(WaitError::Shutdown)), "{ended:?}");
}

/// The newest events are kept, and the others are counted.
#[test]
fn a_program_that_takes_no_events_keeps_few_of_them() {
    let domain = Domain::new();
    let publisher = domain.node("talker").publisher::<u64>("topic").unwrap();
    let events = publisher.events();
    let listener = domain.node("listener");
    const ROUNDS: u64 = 40;
    for _ in 0..ROUNDS {
        let subscriber = listener.subscriber::<u64>("topic").unwrap();
        meet(&publisher, &[&subscriber]);
        drop(subscriber);
        until(|| publisher.links().iter().all(|link| link.end.is_some()));
    }
    let mut taken = 0;
    while let Some(event) = events.try_next().unwrap() {
        let is_join = matches!(event, Event::Joined { .. });
        assert_eq!(is_join, taken % 2 == 0, "{event:?}");
        taken += 1;
    }
    assert_eq!((taken, events.dropped()), (64, 2 * ROUNDS - 64));
}
