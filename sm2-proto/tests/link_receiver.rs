//! The receiving end's view of messages: SPEC section 8.

use crate::link_support::*;
use sm2_proto::{
    FdFacts, Machine,
    limits::INLINE_MAX,
    link::{
        Config, Delivery, Error, Input, Link, Misuse, NoDelivery, NoMemory, Output, Payload, Role,
        SegmentInfo, TooManyBorrowed,
        wire::{Carrier, Form, Frame, MessageFrame},
    },
    violation,
};

fn take(link: &mut Link) -> Delivery {
    link.take(&NoMemory).unwrap().expect("a message is ready")
}

/// Releases a message and returns the packets that the link sends for it.
fn released(link: &mut Link, sequence: u64) -> Vec<Vec<u8>> {
    assert_eq!(give_back(link, sequence), Ok(()));
    sent(&drain(link))
        .iter()
        .map(sm2_proto::link::Packet::to_vec)
        .collect()
}

fn consumed(sequences: &[u64]) -> Vec<u8> {
    release(sm2_proto::link::wire::Given::Consumed, sequences)
}

fn discarded(sequences: &[u64]) -> Vec<u8> {
    release(sm2_proto::link::wire::Given::Discarded, sequences)
}

//= SM2-MSG-004, SM2-MSG-005 test
#[test]
fn the_application_takes_the_oldest_and_holds_no_more_than_it_may() {
    let mut link = opened(reliable(Role::Receiver));
    assert_eq!(link.take(&NoMemory), Ok(None));
    for id in 1..=3 {
        accept(&mut link, &data(id, id));
    }
    assert_eq!((take(&mut link).sequence, link.untaken(&NoMemory)), (1, 2));
    assert_eq!(
        link.take(&NoMemory),
        Err(NoDelivery::TooManyBorrowed(TooManyBorrowed {
            max_borrowed: 1
        }))
    );
    assert_eq!(released(&mut link, 1), [consumed(&[1])]);
    assert_eq!(take(&mut link).sequence, 2);
}

#[test]
fn only_what_is_held_can_be_given_back() {
    let mut link = opened(reliable(Role::Receiver));
    accept(&mut link, &data(1, 1));
    let not_borrowed = Err(Error::Misuse(Misuse::NotBorrowed));
    assert_eq!(give_back(&mut link, 1), not_borrowed, "not taken");
    take(&mut link);
    released(&mut link, 1);
    assert_eq!(give_back(&mut link, 1), not_borrowed, "twice");
}

//= SM2-QOS-001, SM2-MSG-004 test
#[test]
fn one_more_than_depth_displaces_the_oldest() {
    let mut link = opened(config(Role::Receiver));
    accept(&mut link, &data(1, 1));
    accept(&mut link, &data(2, 2));
    let outputs = accept(&mut link, &data(3, 3));
    assert_eq!(outputs[0], Output::Discard { sequence: 1 });
    assert_eq!(sent(&outputs)[0].to_vec(), discarded(&[1]));
    assert_eq!((take(&mut link).sequence, link.untaken(&NoMemory)), (2, 1));
}

//= SM2-QOS-002, SM2-MSG-003 test
#[test]
fn reliable_displaces_nothing_and_ends_at_the_window() {
    let mut link = opened(reliable(Role::Receiver));
    for id in 1..=3 {
        assert_eq!(accept(&mut link, &data(id, id)), []);
    }
    assert_eq!(link.untaken(&NoMemory), 3);
    assert_eq!(
        reject(&mut link, &data(4, 4)),
        violation!(WindowExceeded, "SM2-MSG-003")
    );
}

/// `lost` counts messages after the one taken last that can never be taken.
//= SM2-MSG-002 test
#[test]
fn losses_are_counted_between_what_the_application_takes() {
    let mut link = opened(config(Role::Receiver));
    let mut next = |sequence, id| {
        accept(&mut link, &data(sequence, id));
        let delivery = take(&mut link);
        released(&mut link, delivery.sequence);
        delivery.lost
    };
    assert_eq!(next(1, 40), 0, "what was before the link is not lost");
    assert_eq!(next(2, 41), 0);
    assert_eq!(next(3, 45), 3, "42 to 44 were lost on the other side");
    for (sequence, id) in [(4, 46), (5, 48), (6, 50)] {
        accept(&mut link, &data(sequence, id));
    }
    assert_eq!(
        take(&mut link).lost,
        2,
        "46 was displaced here, 47 over there"
    );
}

#[test]
fn what_is_displaced_before_anything_was_taken_is_lost() {
    let mut link = opened(config(Role::Receiver));
    for id in 1..=3 {
        accept(&mut link, &data(id, id + 10));
    }
    assert_eq!(take(&mut link).lost, 1);
}

/// One RELEASE holds at most 512 sequence numbers, ascending, all with one fate.
//= SM2-MSG-004 test
#[test]
fn releases_are_batched() {
    let config = Config {
        depth: 20,
        max_borrowed: 1000,
        ..config(Role::Receiver)
    };
    let mut link = opened(config);
    link.handle(NOW, Input::Blocked).unwrap();
    for id in 1..=620 {
        accept(&mut link, &data(id, id));
        if id <= 600 {
            take(&mut link);
        }
    }
    accept(&mut link, &data(621, 621)); // displaces 601
    for sequence in (1..=600).rev() {
        give_back(&mut link, sequence).unwrap();
    }
    assert_eq!(drain(&mut link), []);
    link.handle(NOW, Input::Writable).unwrap();
    let frames: Vec<_> = sent(&drain(&mut link))
        .iter()
        .map(|it| it.to_vec())
        .collect();
    let all: Vec<u64> = (1..=600).collect();
    assert_eq!(
        frames,
        [
            discarded(&[601]),
            consumed(&all[..512]),
            consumed(&all[512..])
        ]
    );
}

#[test]
fn a_short_release_needs_no_second_piece() {
    let config = Config {
        max_borrowed: 6,
        ..reliable(Role::Receiver)
    };
    let mut link = opened(config);
    link.handle(NOW, Input::Blocked).unwrap();
    for id in 1..=6 {
        accept(&mut link, &data(id, id));
        take(&mut link);
        give_back(&mut link, id).unwrap();
    }
    link.handle(NOW, Input::Writable).unwrap();
    let [packet] = &sent(&drain(&mut link))[..] else {
        panic!()
    };
    assert_eq!((packet.head.len(), packet.payload.len()), (48, 8));
    assert_eq!(packet.to_vec(), consumed(&[1, 2, 3, 4, 5, 6]));
}

//= SM2-PAY-002 test
#[test]
fn the_longest_inline_payload() {
    for (len, legal) in [(INLINE_MAX, true), (INLINE_MAX + 1, false)] {
        let payload = vec![7; len];
        let message = MessageFrame {
            len: len as u64,
            rest: &payload,
            ..from_peer(Carrier::Data, 1, 1)
        };
        let mut link = opened(config(Role::Receiver));
        if legal {
            accept(&mut link, &Frame::Message(message));
            assert_eq!(take(&mut link).payload, Payload::Inline(payload.into()));
        } else {
            assert_eq!(
                reject(&mut link, &Frame::Message(message)),
                violation!(BadLength, "SM2-PAY-002")
            );
        }
    }
}

//= SM2-PAY-003, SM2-PAY-005, SM2-SEG-003, SM2-SEG-005 test
#[test]
fn a_slot_is_busy_until_its_release_has_left() {
    let mut link = opened(config(Role::Receiver));
    let outputs = accept(&mut link, &Frame::Attach(SEGMENT));
    assert_eq!(
        outputs,
        [Output::Attach {
            segment: 5,
            stride: 4096,
            slots: 2
        }]
    );
    assert_eq!(accept(&mut link, &data_pooled(1, 1, 1)), []);
    let delivery = take(&mut link);
    assert_eq!(
        delivery.payload,
        Payload::Pooled {
            segment: 5,
            offset: 4096
        }
    );
    assert_eq!(delivery.len, 100);
    link.handle(NOW, Input::Blocked).unwrap();
    give_back(&mut link, 1).unwrap();
    drain(&mut link);
    assert_eq!(
        reject(&mut link.clone(), &data_pooled(2, 2, 1)),
        violation!(SlotBusy, "SM2-PAY-005")
    );
    assert_eq!(
        reject(&mut link.clone(), &Frame::Detach { segment: 5 }),
        violation!(SegmentBusy, "SM2-SEG-005")
    );
    link.handle(NOW, Input::Writable).unwrap();
    drain(&mut link);
    accept(&mut link.clone(), &data_pooled(2, 2, 1));
    let outputs = accept(&mut link, &Frame::Detach { segment: 5 });
    assert_eq!(outputs, [Output::Detach { segment: 5 }]);
    accept(
        &mut link,
        &Frame::Attach(SegmentInfo {
            slots: 7,
            ..SEGMENT
        }),
    );
}

//= SM2-PAY-005 test
#[test]
fn a_displaced_message_keeps_its_slot_until_its_release_has_left() {
    let mut link = opened(Config {
        depth: 1,
        ..config(Role::Receiver)
    });
    accept(&mut link, &Frame::Attach(SEGMENT));
    link.handle(NOW, Input::Blocked).unwrap();
    accept(&mut link, &data_pooled(1, 1, 0));
    assert_eq!(
        accept(&mut link, &data_pooled(2, 2, 1)),
        [Output::Discard { sequence: 1 }]
    );
    assert_eq!(
        reject(&mut link.clone(), &data_pooled(3, 3, 0)),
        violation!(WindowExceeded, "SM2-MSG-003")
    );
    link.handle(NOW, Input::Writable).unwrap();
    drain(&mut link);
    accept(&mut link, &data_pooled(3, 3, 0));
}

//= SM2-PAY-004, SM2-SEG-001, SM2-SEG-002 test
#[test]
fn the_descriptor_of_a_sealed_message_is_kept_if_it_may_be_mapped() {
    let frame = |len| {
        let message = from_peer(Carrier::Data, 1, 1);
        Frame::Message(MessageFrame {
            form: Form::Sealed,
            len,
            ..message
        })
        .to_vec()
    };
    let mut link = opened(config(Role::Receiver));
    assert_eq!(feed(&mut link.clone(), &frame(3), &[sealed(3)]), Ok(()));
    feed(&mut link, &frame(3), &[sealed(4)]).unwrap();
    assert_eq!(drain(&mut link), [Output::Keep { sequence: 1 }]);
    assert_eq!(take(&mut link).payload, Payload::Sealed);
    let wrong = |len, facts: FdFacts| {
        let mut link = opened(config(Role::Receiver));
        feed(&mut link, &frame(len), &[facts]).unwrap_err();
        assert!(!drain(&mut link).contains(&Output::Keep { sequence: 1 }));
    };
    wrong(3, sealed(2));
    wrong(3, sealed((1 << 41) + 1));
    wrong((1 << 40) + 1, sealed(1 << 41));
    wrong(3, pooled(3));
    wrong(
        3,
        FdFacts {
            regular: false,
            ..sealed(3)
        },
    );
}
