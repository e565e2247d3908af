//! Calls as seen by both ends: SPEC section 9.

use crate::link_support::*;
use sm2_proto::{
    Machine,
    limits::CALLS_MAX,
    link::{
        Config, End, Error, Fate, Input, Link, Misuse, NoMemory, OutboundMessage, Output, Role,
        Status,
        wire::{Carrier, Frame, Given, MessageFrame},
    },
    violation,
};

fn caller() -> Link {
    opened(config(Role::Caller))
}

fn server() -> Link {
    opened(config(Role::Server))
}

fn cancel(link: &mut Link, call: u64) -> Result<Vec<u8>, Error> {
    link.handle(NOW, Input::Cancel { call })?;
    Ok(sent(&drain(link))
        .iter()
        .flat_map(sm2_proto::link::Packet::to_vec)
        .collect())
}

fn refused(link: &mut Link, message: OutboundMessage) -> Misuse {
    match offer(link, message) {
        Err(Error::Misuse(misuse)) => misuse,
        other => panic!("{other:?}"),
    }
}

//= SM2-SRV-001, SM2-SRV-002 test
#[test]
fn a_call_is_open_until_its_one_reply() {
    let mut link = caller();
    let outputs = send(&mut link, message(4));
    let expected = MessageFrame {
        time: message(4).time,
        ..from_peer(Carrier::Request, 1, 4)
    };
    assert_eq!(
        sent(&outputs)[0].to_vec(),
        Frame::Message(expected).to_vec()
    );
    assert_eq!(refused(&mut link, message(4)), Misuse::IdNotGrowing);
    send(&mut link, message(7));
    assert_eq!(link.calls(), 2);
    assert_eq!(accept(&mut link, &reply(1, 7)), []);
    assert_eq!(
        (link.calls(), link.take(&NoMemory).unwrap().unwrap().id),
        (1, 7)
    );
    assert_eq!(
        reject(&mut link, &reply(2, 7)),
        violation!(UnknownCall, "SM2-SRV-002")
    );
}

//= SM2-SRV-002 test
#[test]
fn every_status_reaches_the_caller() {
    for status in Status::ALL {
        let mut link = caller();
        send(&mut link, message(1));
        accept(
            &mut link,
            &Frame::Message(MessageFrame {
                status,
                ..from_peer(Carrier::Reply, 1, 1)
            }),
        );
        let delivery = link.take(&NoMemory).unwrap().unwrap();
        assert_eq!((delivery.status, delivery.lost), (status, 0));
    }
}

//= SM2-SRV-001 test
#[test]
fn no_more_than_1024_calls_are_open() {
    let mut link = caller();
    for call in 1..=CALLS_MAX as u64 {
        assert!(link.has_room(&NoMemory));
        send(&mut link, message(call));
    }
    assert!(!link.has_room(&NoMemory));
    assert_eq!(refused(&mut link, message(2000)), Misuse::CallLimit);
    accept(&mut link, &reply(1, 1));
    assert!(link.has_room(&NoMemory));
    send(&mut link, message(2000));
}

//= SM2-SRV-002 test
#[test]
fn a_server_replies_once_to_what_it_was_asked() {
    let mut link = server();
    assert_eq!(refused(&mut link, message(1)), Misuse::UnknownCall);
    accept(&mut link, &request(1, 1));
    assert_eq!(link.calls(), 1);
    let outputs = send(
        &mut link,
        OutboundMessage {
            status: Status::Failed,
            ..message(1)
        },
    );
    assert_eq!(
        (sent(&outputs)[0].head[0], sent(&outputs)[0].head[2]),
        (6, 1)
    );
    assert_eq!(link.calls(), 0);
    assert_eq!(refused(&mut link, message(1)), Misuse::UnknownCall);
}

//= SM2-SRV-002 test
#[test]
fn a_cancelled_call_has_no_payload() {
    for (status, legal) in [
        (Status::Ok, true),
        (Status::Cancelled, false),
        (Status::DeadlinePassed, false),
    ] {
        let mut link = server();
        accept(&mut link, &request(1, 1));
        let body = sm2_proto::link::Body::Inline(bytes::Bytes::from_static(b"x"));
        let message = OutboundMessage {
            status,
            len: 1,
            body,
            ..message(1)
        };
        let result = offer(&mut link, message);
        assert_eq!(result.is_ok(), legal, "{status:?}");
    }
}

/// The number of open calls bounds the waiting replies, so a server can always reply at once.
#[test]
fn a_reply_always_has_room() {
    let large = Config {
        depth: 1024,
        max_borrowed: 1024,
        ..config(Role::Server)
    };
    let mut link = opened_with(large, &open_with(&large, 1));
    for call in 1..=CALLS_MAX as u64 {
        accept(&mut link, &request(call, call));
    }
    for call in 1..=CALLS_MAX as u64 {
        assert!(link.has_room(&NoMemory));
        send(&mut link, message(call));
    }
    assert_eq!((link.in_flight(), link.calls()), (CALLS_MAX, CALLS_MAX - 1));
}

/// A reply that waits for the window has not been sent, so its call still counts as open.
//= SM2-SRV-001 test
#[test]
fn a_call_counts_until_its_reply_has_left() {
    let large = Config {
        depth: 1024,
        max_borrowed: 1024,
        ..config(Role::Server)
    };
    let mut link = opened_with(large, &open_with(&large, 1));
    for call in 1..=CALLS_MAX as u64 {
        accept(&mut link, &request(call, call));
    }
    send(&mut link, message(1));
    send(&mut link, message(2)); // waits
    accept(&mut link, &request(1025, 1025));
    assert_eq!(
        reject(&mut link, &request(1026, 1026)),
        violation!(CallLimit, "SM2-SRV-001")
    );
}

//= SM2-SRV-003 test
#[test]
fn a_call_is_cancelled_once() {
    let mut link = caller();
    assert_eq!(
        cancel(&mut link, 1),
        Err(Error::Misuse(Misuse::UnknownCall))
    );
    send(&mut link, message(1));
    assert_eq!(cancel(&mut link, 1), Ok(Frame::Cancel { call: 1 }.to_vec()));
    assert_eq!(cancel(&mut link, 1), Ok(vec![]));
    accept(&mut link, &reply(1, 1));
    assert_eq!(cancel(&mut link, 1), Ok(vec![]), "it has its reply");
}

//= SM2-SRV-003 test
#[test]
fn cancel_leaves_after_its_request() {
    let mut link = opened_with(config(Role::Caller), &open_with(&config(Role::Caller), 1));
    send(&mut link, message(1));
    send(&mut link, message(2));
    assert_eq!(
        cancel(&mut link, 2),
        Ok(vec![]),
        "the request waits for the window"
    );
    let packets = sent(&release_all(&mut link, Given::Consumed, &[1]));
    let kinds: Vec<u8> = packets.iter().map(|it| it.head[0]).collect();
    assert_eq!(kinds, [5, 8]);
}

//= SM2-SRV-003 test
#[test]
fn a_cancel_that_the_reply_overtook_is_not_sent() {
    let mut link = caller();
    send(&mut link, message(1));
    link.handle(NOW, Input::Blocked).unwrap();
    link.handle(NOW, Input::Cancel { call: 1 }).unwrap();
    accept(&mut link, &reply(1, 1));
    link.handle(NOW, Input::Writable).unwrap();
    assert_eq!(drain(&mut link), []);
}

//= SM2-SRV-003 test
#[test]
fn the_server_hears_of_a_cancel_and_still_replies() {
    let mut link = server();
    accept(&mut link, &request(1, 1));
    assert_eq!(
        accept(&mut link, &Frame::Cancel { call: 1 }),
        [Output::Cancelled { call: 1 }]
    );
    assert_eq!(link.calls(), 1);
    let outputs = send(
        &mut link,
        OutboundMessage {
            status: Status::Cancelled,
            ..message(1)
        },
    );
    assert_eq!(sent(&outputs).len(), 1);
}

//= SM2-SRV-003 test
#[test]
fn a_cancel_that_crossed_the_reply_is_ignored_once() {
    let mut link = server();
    accept(&mut link, &request(1, 1));
    send(&mut link, message(1));
    let mut released = link.clone();
    assert_eq!(accept(&mut link, &Frame::Cancel { call: 1 }), []);
    assert_eq!(
        reject(&mut link, &Frame::Cancel { call: 1 }),
        violation!(BadCancel, "SM2-SRV-003")
    );
    release_all(&mut released, Given::Consumed, &[1]);
    assert_eq!(
        reject(&mut released, &Frame::Cancel { call: 1 }),
        violation!(UnknownCall, "SM2-SRV-003")
    );
}

//= SM2-SRV-004 test
#[test]
fn when_the_link_ends_calls_without_a_reply_fail() {
    let mut link = caller();
    for call in 1..=4 {
        send(&mut link, message(call));
    }
    accept(&mut link, &reply(1, 2));
    link.handle(NOW, Input::Eof).unwrap();
    let outputs = drain(&mut link);
    assert_eq!(
        settled(&outputs),
        [1, 2, 3, 4].map(|key| (key, Fate::Closed))
    );
    let failed = [1, 3, 4].map(|call| Output::CallFailed { call });
    assert_eq!(outputs[4..7], failed);
    assert_eq!(outputs[7..], [Output::Ended(End::Eof)]);
    assert_eq!(
        link.take(&NoMemory).unwrap().unwrap().id,
        2,
        "a reply that came is still there"
    );
}
