//! The messages of latched topics that a hub keeps for peers that connect later.

use bytes::Bytes;
use sm2_gateway::{
    hub::{Hub, LATCHED_MAX, LocalEvent, Output},
    peer::{Command, Event},
};
use sm2_proto::gateway::{OfferId, Subject, session};

use super::{NOW, bytes, greet, hub, local, message, name, offered, outputs, publications, tell};

fn latched(latched: u16) -> Subject {
    Subject::Topic {
        name: name("map"),
        data: bytes(),
        reliable: false,
        latched,
    }
}

/// The sequence numbers of the messages that are sent on a connection.
fn sent(outputs: &[Output], to: u64) -> Vec<u64> {
    let of = |it: &Output| match it {
        Output::Peer {
            connection,
            command: Command::Message { message, .. },
        } if connection.0 == to => Some(message.sequence),
        _ => None,
    };
    outputs.iter().filter_map(of).collect()
}

fn publish(hub: &mut Hub, subject: &Subject, len_bytes: usize) -> Vec<Output> {
    let event = LocalEvent::Message {
        subject: subject.clone(),
        published_at: NOW,
        payload: Bytes::from(vec![0; len_bytes]),
    };
    local(hub, event)
}

/// The domain has a publisher of the topic, peers 2 and 3 are connected, and peer 2 wants the
/// topic.
fn wanted(subject: &Subject) -> Hub {
    let mut hub = hub();
    greet(&mut hub, 2, 2, 7);
    greet(&mut hub, 3, 3, 7);
    let (subject, present) = (subject.clone(), true);
    local(&mut hub, LocalEvent::Present { subject, present });
    want(&mut hub, 2);
    hub
}

fn want(hub: &mut Hub, connection: u64) -> Vec<Output> {
    let (offer, depth) = (OfferId(1), 8);
    tell(
        hub,
        connection,
        Event::Session(session::Event::Wanted { offer, depth }),
    )
}

//= SM2-GWM-009 test
#[test]
fn a_peer_that_comes_later_gets_the_newest_of_what_is_latched() {
    let subject = latched(2);
    let mut hub = wanted(&subject);
    for number in 1..=3 {
        assert_eq!(sent(&publish(&mut hub, &subject, 1), 2), [number]);
    }
    let said = want(&mut hub, 3);
    assert_eq!(sent(&said, 3), [2, 3]);
    assert!(sent(&said, 2).is_empty(), "it had them");
    // Nobody has wanted the topic for a while, so the kept messages may be stale.
    for connection in [2, 3] {
        tell(
            &mut hub,
            connection,
            Event::Session(session::Event::Unwanted { offer: OfferId(1) }),
        );
    }
    assert!(sent(&want(&mut hub, 2), 2).is_empty());
    // Messages of a topic that is not latched are not kept.
    let subject = latched(0);
    let mut hub = wanted(&subject);
    publish(&mut hub, &subject, 1);
    assert!(sent(&want(&mut hub, 3), 3).is_empty());
}

#[test]
fn what_is_kept_is_bounded() {
    let subject = latched(1_024);
    let mut hub = wanted(&subject);
    for _ in 0..100 {
        publish(&mut hub, &subject, 1);
    }
    assert_eq!(sent(&want(&mut hub, 3), 3).len(), usize::from(LATCHED_MAX));
    // 20 MiB each: three fit into 64 MiB.
    let mut hub = wanted(&subject);
    for _ in 0..5 {
        publish(&mut hub, &subject, 20 << 20);
    }
    assert_eq!(sent(&want(&mut hub, 3), 3), [3, 4, 5]);
}

/// A hub that passes messages of peer 2 on to peer 3.
//= SM2-GWM-008, SM2-GWM-009 test
#[test]
fn what_is_latched_comes_again_when_it_is_wanted_again() {
    let mut hub = hub();
    greet(&mut hub, 2, 2, 2);
    greet(&mut hub, 3, 3, 7);
    greet(&mut hub, 4, 4, 7);
    offered(&mut hub, 2, 1, latched(1), &[2]);
    want(&mut hub, 3);
    assert_eq!(sent(&tell(&mut hub, 2, message(1, 9)), 3), [9]);
    assert_eq!(sent(&want(&mut hub, 4), 4), [9]);
    // While the topic stays wanted, a message with the same number is not published again.
    assert_eq!(publications(&tell(&mut hub, 2, message(1, 9))), 0);
    for connection in [3, 4] {
        tell(
            &mut hub,
            connection,
            Event::Session(session::Event::Unwanted { offer: OfferId(1) }),
        );
    }
    assert!(sent(&want(&mut hub, 3), 3).is_empty());
    let again = tell(&mut hub, 2, message(1, 9));
    assert_eq!((sent(&again, 3), publications(&again)), (vec![9], 1));
    assert!(outputs(&mut hub).is_empty());
}
