//! The sending end's view of messages: SPEC section 8.

use crate::link_support::*;
use bytes::Bytes;
use sm2_proto::{
    Instant, Machine,
    limits::{INLINE_MAX, MESSAGE_MAX},
    link::{
        Attachment, Body, Config, Counters, Error, Fate, Input, Link, Misuse, NoMemory,
        OutboundMessage, Output, Packet, Role, SegmentInfo, Status,
        wire::{Form, Frame, Given},
    },
};

fn refused(link: &mut Link, message: OutboundMessage) -> Misuse {
    let before = link.clone();
    match offer(link, message) {
        Err(Error::Misuse(misuse)) => {
            assert_eq!(*link, before, "misuse changes nothing");
            misuse
        }
        other => panic!("{other:?}"),
    }
}

/// The sequence numbers and ids of the messages among the outputs.
fn numbers(outputs: &[Output]) -> Vec<(u64, u64)> {
    let number = |packet: &Packet| {
        let bytes = packet.to_vec();
        let at = |at: usize| u64::from_le_bytes(bytes[at..at + 8].try_into().unwrap());
        (bytes[0] == 4).then(|| (at(16), at(24)))
    };
    sent(outputs).iter().filter_map(number).collect()
}

//= SM2-MSG-001, SM2-MSG-002, SM2-PAY-002 test
#[test]
fn an_inline_message_follows_its_header() {
    let mut link = opened(config(Role::Sender));
    let payload = Bytes::from_static(b"hello");
    let time = Instant(0x0102_0304_0506_0708);
    let message = OutboundMessage {
        id: 9,
        time,
        len: 5,
        body: Body::Inline(payload.clone()),
        ..message(1)
    };
    let outputs = send(&mut link, message);
    let [Output::Transmit(packet)] = &outputs[..] else {
        panic!("{outputs:?}")
    };
    let expected = [
        &[4, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0][..],
        &[1, 0, 0, 0, 0, 0, 0, 0, 9, 0, 0, 0, 0, 0, 0, 0],
        &[8, 7, 6, 5, 4, 3, 2, 1, 5, 0, 0, 0, 0, 0, 0, 0],
        b"hello",
    ];
    assert_eq!(packet.to_vec(), expected.concat());
    assert_eq!((packet.payload.clone(), packet.attachment), (payload, None));
}

//= SM2-PAY-004 test
#[test]
fn a_sealed_message_takes_its_descriptor_along() {
    let mut link = opened(Config {
        sealed: true,
        ..config(Role::Sender)
    });
    let message = OutboundMessage {
        key: 77,
        len: MESSAGE_MAX,
        body: Body::Sealed,
        ..message(1)
    };
    let outputs = send(&mut link, message);
    let [packet] = &sent(&outputs)[..] else {
        panic!("{outputs:?}")
    };
    assert_eq!(packet.attachment, Some(Attachment::Message(77)));
    assert_eq!((packet.len_bytes(), packet.to_vec()[1]), (48, 2));
}

//= SM2-PAY-003, SM2-SEG-003 test
#[test]
fn a_segment_is_attached_once_before_its_first_message() {
    let mut link = opened(config(Role::Sender));
    let first = sent(&send(&mut link, pooled_message(1, SEGMENT, 0)));
    assert_eq!(first.len(), 2);
    assert_eq!(first[0].to_vec(), Frame::Attach(SEGMENT).to_vec());
    assert_eq!(first[0].attachment, Some(Attachment::Segment(5)));
    assert_eq!((first[1].to_vec()[1], first[1].attachment), (1, None));
    assert_eq!(
        sent(&send(&mut link, pooled_message(2, SEGMENT, 1))).len(),
        1
    );
}

//= SM2-MSG-003 test
#[test]
fn no_more_than_the_window_is_unreleased() {
    let mut link = opened(config(Role::Sender));
    let mut outputs = Vec::new();
    for id in 1..=5 {
        outputs.extend(send(&mut link, message(id)));
        assert_eq!(link.has_queued(), id > 3, "{id}");
    }
    assert_eq!(numbers(&outputs), [(1, 1), (2, 2), (3, 3)]);
    let outputs = release_all(&mut link, Given::Consumed, &[2]);
    assert_eq!(settled(&outputs), [(2, Fate::Delivered)]);
    assert_eq!(numbers(&outputs), [(4, 4)]);
    assert_eq!(link.in_flight(), 4);
    assert!(link.has_queued());
    release_all(&mut link, Given::Consumed, &[1]);
    assert!(!link.has_queued());
}

//= SM2-QOS-001, SM2-QOS-006 test
#[test]
fn keep_last_displaces_the_oldest_that_waits() {
    let mut link = opened(config(Role::Sender));
    for id in 1..=5 {
        assert!(link.has_room(&NoMemory));
        assert_eq!(settled(&send(&mut link, message(id))), []);
    }
    assert!(!link.has_room(&NoMemory));
    assert_eq!(
        settled(&send(&mut link, message(6))),
        [(4, Fate::Overwritten)]
    );
    let outputs = release_all(&mut link, Given::Discarded, &[1, 2]);
    assert_eq!(
        settled(&outputs),
        [(1, Fate::Discarded), (2, Fate::Discarded)]
    );
    assert_eq!(numbers(&outputs), [(4, 5), (5, 6)]);
    let expected = Counters {
        offered: 6,
        overwritten: 1,
        discarded: 2,
        in_flight: 3,
        ..Counters::default()
    };
    assert_eq!(link.counters(), expected);
}

//= SM2-QOS-006, SM2-QOS-007 test
#[test]
fn a_publication_that_the_pool_limit_drops_is_counted_until_a_release() {
    let mut link = opened(config(Role::Sender));
    send(&mut link, message(1));
    for _ in 0..2 {
        link.handle(NOW, Input::Drop(Fate::PoolLimit)).unwrap();
        assert!(link.owes() && link.has_room(&NoMemory));
    }
    release_all(&mut link, Given::Consumed, &[1]);
    assert!(!link.owes());
    let expected = Counters {
        offered: 3,
        delivered: 1,
        pool_limit: 2,
        ..Counters::default()
    };
    assert_eq!(link.counters(), expected);
    assert_eq!(link.counters().dropped(), 2);
}

//= SM2-QOS-001 test
#[test]
fn before_open_keep_last_holds() {
    let config = config(Role::Sender);
    let mut link = Link::new(config);
    drain(&mut link);
    let outputs: Vec<_> = (1..=4)
        .flat_map(|id| send(&mut link, message(id)))
        .collect();
    assert_eq!(
        settled(&outputs),
        [(1, Fate::Overwritten), (2, Fate::Overwritten)]
    );
    assert_eq!(
        numbers(&accept(&mut link, &open_to(&config))),
        [(1, 3), (2, 4)]
    );
}

/// A newer message never displaces one that waits only for the socket: the window has admitted it.
//= SM2-QOS-001 test
#[test]
fn a_blocked_socket_displaces_only_what_the_window_does_not_admit() {
    let mut link = opened(config(Role::Sender));
    link.handle(NOW, Input::Blocked).unwrap();
    let outputs: Vec<_> = (1..=7)
        .flat_map(|id| send(&mut link, message(id)))
        .collect();
    assert_eq!(
        settled(&outputs),
        [(4, Fate::Overwritten), (5, Fate::Overwritten)]
    );
    link.handle(NOW, Input::Writable).unwrap();
    assert_eq!(numbers(&drain(&mut link)), [(1, 1), (2, 2), (3, 3)]);
}

//= SM2-QOS-002, SM2-QOS-003, SM2-QOS-006 test
#[test]
fn reliable_waits_for_room_or_skips() {
    let mut link = opened(reliable(Role::Sender));
    assert_eq!(
        link.handle(NOW, Input::Drop(Fate::NoRoom)),
        Err(Error::Misuse(Misuse::RoomLeft))
    );
    for id in 1..=5 {
        assert_eq!(settled(&send(&mut link, message(id))), []);
    }
    assert!(!link.has_room(&NoMemory) && !link.owes());
    assert_eq!(refused(&mut link, message(6)), Misuse::NoRoom);
    assert_eq!(link.handle(NOW, Input::Drop(Fate::NoRoom)), Ok(()));
    assert_eq!(drain(&mut link), []);
    assert!(link.owes());
    // It has room again, but owes until all five have come back.
    release_all(&mut link, Given::Consumed, &[1]);
    assert!(link.has_room(&NoMemory) && link.owes());
    send(&mut link, message(7));
    assert_eq!(link.handle(NOW, Input::Drop(Fate::NoRoom)), Ok(()));
    release_all(&mut link, Given::Consumed, &[2, 3]);
    send(&mut link, message(9));
    release_all(&mut link, Given::Consumed, &[4, 5]);
    assert!(link.owes());
    release_all(&mut link, Given::Consumed, &[6]);
    assert!(!link.owes());
    let expected = Counters {
        offered: 9,
        delivered: 6,
        no_room: 2,
        in_flight: 1,
        ..Counters::default()
    };
    assert_eq!(link.counters(), expected);
}

//= SM2-MSG-004 test
#[test]
fn an_illegal_release_settles_nothing_of_it() {
    for named in [&[1, 4][..], &[2, 1], &[1, 1], &[0, 1], &[]] {
        let mut link = opened(config(Role::Sender));
        for id in 1..=3 {
            send(&mut link, message(id));
        }
        feed(&mut link, &release(Given::Consumed, named), &[]).unwrap_err();
        let expected = [1, 2, 3].map(|key| (key, Fate::Closed));
        assert_eq!(settled(&drain(&mut link)), expected, "{named:?}");
    }
}

//= SM2-MSG-004 test
#[test]
fn release_names_at_most_512() {
    for (count, legal) in [(512, true), (513, false)] {
        let config = Config {
            depth: 1024,
            ..config(Role::Sender)
        };
        let mut link = opened_with(config, &open_with(&config, 1024));
        for id in 1..=1024 {
            send(&mut link, message(id));
        }
        let named: Vec<u64> = (1..=count).collect();
        assert_eq!(
            feed(&mut link, &release(Given::Consumed, &named), &[]).is_ok(),
            legal
        );
    }
}

//= SM2-SEG-004, SM2-SEG-005 test
#[test]
fn a_257th_segment_takes_the_place_of_the_longest_attached_idle_one() {
    let config = Config {
        depth: 1024,
        ..config(Role::Sender)
    };
    let mut link = opened_with(config, &open_with(&config, 1024));
    let segment = |id| SegmentInfo { id, ..SEGMENT };
    for id in 0..256 {
        send(&mut link, pooled_message(u64::from(id) + 1, segment(id), 0));
    }
    assert_eq!(
        refused(&mut link, pooled_message(300, segment(256), 0)),
        Misuse::SegmentLimit
    );
    release_all(&mut link, Given::Consumed, &[3, 8]);
    let packets = sent(&send(&mut link, pooled_message(300, segment(256), 0)));
    let frames: Vec<_> = packets.iter().map(Packet::to_vec).collect();
    assert_eq!(frames[0], Frame::Detach { segment: 2 }.to_vec());
    assert_eq!(frames[1], Frame::Attach(segment(256)).to_vec());
    let again = sent(&send(&mut link, pooled_message(301, segment(2), 0)));
    assert_eq!(again[0].to_vec(), Frame::Detach { segment: 7 }.to_vec());
    assert_eq!(again[1].to_vec(), Frame::Attach(segment(2)).to_vec());
}

//= SM2-SEG-005 test
#[test]
fn retire_detaches_what_is_attached_and_free() {
    let mut link = opened(config(Role::Sender));
    let retire = Input::Retire { segment: 5 };
    assert_eq!(link.handle(NOW, retire.clone()), Ok(()));
    assert_eq!(drain(&mut link), [], "not attached");
    send(&mut link, pooled_message(1, SEGMENT, 0));
    assert_eq!(
        link.handle(NOW, retire.clone()),
        Err(Error::Misuse(Misuse::SegmentBusy))
    );
    release_all(&mut link, Given::Consumed, &[1]);
    assert_eq!(link.handle(NOW, retire.clone()), Ok(()));
    let detach = Frame::Detach { segment: 5 }.to_vec();
    assert_eq!(sent(&drain(&mut link))[0].to_vec(), detach);
    assert_eq!(link.handle(NOW, retire), Ok(()));
    assert_eq!(drain(&mut link), []);
    let other = SegmentInfo {
        slots: 9,
        ..SEGMENT
    };
    assert_eq!(sent(&send(&mut link, pooled_message(2, other, 8))).len(), 2);
}

#[test]
fn a_retired_number_can_be_used_again_before_its_detach_has_left() {
    let mut link = opened(config(Role::Sender));
    send(&mut link, pooled_message(1, SEGMENT, 0));
    release_all(&mut link, Given::Consumed, &[1]);
    link.handle(NOW, Input::Blocked).unwrap();
    link.handle(NOW, Input::Retire { segment: 5 }).unwrap();
    let other = SegmentInfo {
        slots: 9,
        ..SEGMENT
    };
    send(&mut link, pooled_message(2, other, 8));
    link.handle(NOW, Input::Writable).unwrap();
    let kinds: Vec<u8> = sent(&drain(&mut link))
        .iter()
        .map(|it| it.head[0])
        .collect();
    assert_eq!(kinds, [3, 2, 4]);
}

//= SM2-PAY-005, SM2-PAY-008 test
#[test]
fn what_the_other_end_would_reject_is_not_sent() {
    let mut link = opened(config(Role::Sender));
    send(&mut link, pooled_message(10, SEGMENT, 0));
    let inline = |len: usize| Body::Inline(vec![0; len].into());
    let over = INLINE_MAX + 1;
    let sized = |len: u64, body| OutboundMessage {
        len,
        body,
        ..message(11)
    };
    let rows = [
        (message(10), Misuse::IdNotGrowing),
        (message(9), Misuse::IdNotGrowing),
        (
            OutboundMessage {
                status: Status::Failed,
                ..message(11)
            },
            Misuse::Status,
        ),
        (sized(1, inline(2)), Misuse::Length),
        (sized(over as u64, inline(over)), Misuse::TooLong),
        (sized(MESSAGE_MAX + 1, Body::Sealed), Misuse::TooLong),
        (
            sized(
                4097,
                Body::Pooled {
                    segment: SEGMENT,
                    slot: 1,
                },
            ),
            Misuse::TooLong,
        ),
        (pooled_message(11, SEGMENT, 0), Misuse::SlotBusy),
        (pooled_message(11, SEGMENT, 2), Misuse::SlotOutside),
        (
            pooled_message(
                11,
                SegmentInfo {
                    slots: 3,
                    ..SEGMENT
                },
                1,
            ),
            Misuse::SegmentChanged,
        ),
    ];
    for (message, misuse) in rows {
        assert_eq!(refused(&mut link, message.clone()), misuse, "{message:?}");
    }
    for (stride, slots) in [(0, 1), (4097, 1), (4096, 0), (4096, 65_537), (1 << 63, 2)] {
        let id = 6;
        let message = pooled_message(11, SegmentInfo { id, stride, slots }, 0);
        let misuse = refused(&mut link, message);
        assert_eq!(misuse, Misuse::BadSegment, "{slots} slots of {stride}");
    }
}

//= SM2-PAY-001, SM2-PAY-008 test
#[test]
fn a_sealed_link_sends_no_pooled_message() {
    let mut link = opened(Config {
        sealed: true,
        ..config(Role::Sender)
    });
    assert_eq!(
        refused(&mut link, pooled_message(1, SEGMENT, 0)),
        Misuse::NotSealed
    );
    send(
        &mut link,
        OutboundMessage {
            len: INLINE_MAX as u64,
            body: Body::Inline(vec![0; INLINE_MAX].into()),
            ..message(1)
        },
    );
}

/// A hostile peer cannot release a message that still waits for the window or the socket.
//= SM2-MSG-003, SM2-MSG-004 test
#[test]
fn what_was_not_sent_cannot_be_released() {
    let mut link = opened(config(Role::Sender));
    link.handle(NOW, Input::Blocked).unwrap();
    send(&mut link, message(1));
    feed(&mut link, &release(Given::Consumed, &[1]), &[]).unwrap_err();
}

#[test]
fn a_message_in_every_form_is_decoded_as_it_was_meant() {
    let mut link = opened(config(Role::Sender));
    let outputs = [
        send(&mut link, pooled_message(1, SEGMENT, 1)),
        send(
            &mut link,
            OutboundMessage {
                len: 3,
                body: Body::Sealed,
                ..message(2)
            },
        ),
        send(&mut link, message(3)),
    ];
    let mut forms = Vec::new();
    for packet in sent(&outputs.concat()) {
        let bytes = packet.to_vec();
        let fds = vec![sealed(0); usize::from(packet.attachment.is_some())];
        let datagram = sm2_proto::Datagram {
            bytes: &bytes,
            fds: &fds,
            ..Default::default()
        };
        if let Frame::Message(message) = Frame::decode(&datagram).unwrap() {
            forms.push(message.form);
        }
    }
    assert_eq!(
        forms,
        [
            Form::Pooled {
                segment: 5,
                slot: 1
            },
            Form::Sealed,
            Form::Inline
        ]
    );
}
