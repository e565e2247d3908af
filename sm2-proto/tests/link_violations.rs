//! One row for each violation by the other end: the smallest wrong input, the CLOSE that answers
//! it, and a check that the link has ended for good.

// Shows LNK-STRICT (test), bound: a row for each violation.

mod ring;

use std::collections::BTreeSet;

use crate::link_support::*;
use sm2_proto::{
    Code, Datagram, FdFacts, Machine, Seals, Violation, ViolationKind,
    link::{
        Config, End, Error, Fate, Input, Link, MaxLen, Output, Role, SegmentInfo, Status,
        wire::{Carrier, Form, Frame, Given, MessageFrame, Open},
    },
    violation,
};

/// The wrong input, and the role and state of the end that receives it.
#[derive(Clone)]
struct Row {
    violation: Violation,
    link: Link,
    bytes: Vec<u8>,
    fds: Vec<FdFacts>,
}

fn row(violation: Violation, link: Link, frame: &Frame<'_>) -> Row {
    Row {
        violation,
        link,
        bytes: frame.to_vec(),
        fds: fds_for(frame),
    }
}

fn rows() -> Vec<Row> {
    [
        datagram_rows(),
        open_rows(),
        flow_rows(),
        segment_rows(),
        service_rows(),
        ring::lane_rows(),
        ring::file_rows(),
        ring::detached_rows(),
    ]
    .concat()
}

fn receiver() -> Link {
    opened(config(Role::Receiver))
}

fn sender() -> Link {
    opened(config(Role::Sender))
}

fn attached() -> Link {
    let mut link = receiver();
    accept(&mut link, &Frame::Attach(SEGMENT));
    link
}

fn datagram_rows() -> Vec<Row> {
    let raw = |violation, link, bytes: &[u8], fds: &[FdFacts]| Row {
        violation,
        link,
        bytes: bytes.to_vec(),
        fds: fds.to_vec(),
    };
    let mut reserved = data(1, 1).to_vec();
    reserved[12] = 1;
    vec![
        raw(
            violation!(FrameTooLong, "SM2-TRN-004"),
            sender(),
            &[9; 65_537],
            &[],
        ),
        raw(violation!(UnknownFrame, "SM2-WIR-001"), sender(), &[0], &[]),
        raw(violation!(BadLength, "SM2-WIR-001"), sender(), &[9], &[]),
        raw(
            violation!(ReservedNotZero, "SM2-WIR-001"),
            receiver(),
            &reserved,
            &[],
        ),
        raw(
            violation!(Malformed, "SM2-MSG-004"),
            sender(),
            &[7, 3, 0, 0, 0, 0, 0, 0],
            &[],
        ),
        raw(
            violation!(FdCount, "SM2-TRN-010"),
            sender(),
            &[9, 0, 0, 0, 0, 0, 0, 0],
            &[sealed(1)],
        ),
    ]
}

fn open_rows() -> Vec<Row> {
    let fresh = || Link::new(config(Role::Sender));
    let Frame::Open(open) = open_to(&config(Role::Sender)) else {
        unreachable!()
    };
    let changed = |change: &dyn Fn(&mut Open)| {
        let mut open = open;
        change(&mut open);
        Frame::Open(open)
    };
    vec![
        row(
            violation!(ExpectedOpen, "SM2-OPN-001"),
            fresh(),
            &Frame::Detach { segment: 1 },
        ),
        row(
            violation!(UnexpectedOpen, "SM2-OPN-001"),
            sender(),
            &Frame::Open(open),
        ),
        row(
            violation!(BadOpen, "SM2-OPN-002"),
            fresh(),
            &changed(&|it| it.role = 0),
        ),
        row(
            violation!(BadOpen, "SM2-OPN-004"),
            fresh(),
            &changed(&|it| it.lanes = 0),
        ),
        row(
            violation!(BadOpen, "SM2-OPN-005"),
            fresh(),
            &changed(&|it| it.max_len = 0),
        ),
        row(
            violation!(BadOpen, "SM2-OPN-005"),
            fresh(),
            &changed(&|it| it.max_len = (1 << 30) + 1),
        ),
        row(
            violation!(BadOpen, "SM2-OPN-006"),
            fresh(),
            &changed(&|it| it.publications.publisher = 1),
        ),
        row(
            violation!(BadOpen, "SM2-OPN-006"),
            fresh(),
            &changed(&|it| it.publications.published = 1),
        ),
        row(
            violation!(BadWindow, "SM2-OPN-003"),
            fresh(),
            &changed(&|it| it.window = 0),
        ),
        row(violation!(WrongRole, "SM2-WIR-002"), sender(), &data(1, 1)),
    ]
}

fn flow_rows() -> Vec<Row> {
    let mut one = receiver();
    accept(&mut one, &data(1, 1));
    let mut with_slot = attached();
    accept(&mut with_slot, &data_pooled(1, 1, 0));
    let long = MessageFrame {
        len: 4097,
        ..pooled_frame(0)
    };
    let sealed_link = opened(Config {
        sealed: true,
        ..config(Role::Receiver)
    });
    vec![
        row(
            violation!(BadSequence, "SM2-MSG-001"),
            receiver(),
            &data(2, 1),
        ),
        row(violation!(BadId, "SM2-MSG-002"), one, &data(2, 1)),
        row(violation!(BadId, "SM2-MSG-002"), receiver(), &data(1, 0)),
        row(
            violation!(WindowExceeded, "SM2-MSG-003"),
            blocked_full(),
            &data(4, 4),
        ),
        row(
            violation!(BadRelease, "SM2-MSG-004"),
            sender(),
            &Frame::Release {
                given: Given::Consumed,
                count: 0,
                rest: &[],
            },
        ),
        expired_row(),
        row(
            violation!(UnknownSegment, "SM2-PAY-003"),
            receiver(),
            &data_pooled(1, 1, 0),
        ),
        row(
            violation!(BadSlot, "SM2-PAY-003"),
            attached(),
            &data_pooled(1, 1, 2),
        ),
        row(
            violation!(BadLength, "SM2-PAY-003"),
            attached(),
            &Frame::Message(long),
        ),
        row(
            violation!(SlotBusy, "SM2-PAY-005"),
            with_slot,
            &data_pooled(2, 2, 0),
        ),
        row(
            violation!(NotSealed, "SM2-PAY-001"),
            sealed_link.clone(),
            &data_pooled(1, 1, 0),
        ),
        row(
            violation!(NotSealed, "SM2-PAY-001"),
            sealed_link,
            &Frame::Attach(SEGMENT),
        ),
        too_long_row(),
    ]
}

/// A message without a lifespan cannot expire.
fn expired_row() -> Row {
    row(
        violation!(BadRelease, "SM2-QOS-010"),
        sender(),
        &Frame::Release {
            given: Given::Expired,
            count: 0,
            rest: &[],
        },
    )
}

fn too_long_row() -> Row {
    let link = opened(Config {
        max_len: MaxLen::LEAST,
        ..config(Role::Receiver)
    });
    let frame = Frame::Message(MessageFrame {
        form: Form::Sealed,
        len: 1_025,
        ..from_peer(Carrier::Data, 1, 1)
    });
    row(violation!(MessageTooLong, "SM2-PAY-010"), link, &frame)
}

/// A receiver with three of three messages unreleased: the RELEASE of the displaced one waits for
/// the socket.
fn blocked_full() -> Link {
    let mut link = receiver();
    link.handle(NOW, Input::Blocked).unwrap();
    for id in 1..=3 {
        accept(&mut link, &data(id, id));
    }
    link.handle(NOW, Input::Writable).unwrap();
    link
}

fn pooled_frame(slot: u32) -> MessageFrame<'static> {
    let form = Form::Pooled {
        segment: SEGMENT.id,
        slot,
    };
    MessageFrame {
        form,
        len: 1,
        ..from_peer(Carrier::Data, 1, 1)
    }
}

fn segment_rows() -> Vec<Row> {
    let attach = Frame::Attach(SEGMENT);
    let facts = pooled(8192);
    let with = |violation, facts| Row {
        violation,
        link: receiver(),
        bytes: attach.to_vec(),
        fds: vec![facts],
    };
    let mut busy = attached();
    accept(&mut busy, &data_pooled(1, 1, 0));
    let mut full = receiver();
    for id in 0..256 {
        accept(&mut full, &Frame::Attach(SegmentInfo { id, ..SEGMENT }));
    }
    vec![
        with(
            violation!(NotAMemfd, "SM2-SEG-001"),
            FdFacts {
                regular: false,
                ..facts
            },
        ),
        with(
            violation!(SealsMissing, "SM2-SEG-001"),
            FdFacts {
                seals: Seals::SEALED,
                ..facts
            },
        ),
        with(
            violation!(BadSize, "SM2-SEG-003"),
            FdFacts {
                size_bytes: 8191,
                ..facts
            },
        ),
        row(violation!(BadSegmentId, "SM2-SEG-003"), attached(), &attach),
        row(
            violation!(BadSegment, "SM2-SEG-003"),
            receiver(),
            &Frame::Attach(SegmentInfo {
                slots: 0,
                ..SEGMENT
            }),
        ),
        row(
            violation!(SegmentLimit, "SM2-SEG-004"),
            full,
            &Frame::Attach(SegmentInfo { id: 256, ..SEGMENT }),
        ),
        row(
            violation!(UnknownSegment, "SM2-SEG-005"),
            receiver(),
            &Frame::Detach { segment: 5 },
        ),
        row(
            violation!(SegmentBusy, "SM2-SEG-005"),
            busy,
            &Frame::Detach { segment: 5 },
        ),
    ]
}

fn service_rows() -> Vec<Row> {
    let large = Config {
        depth: 1024,
        max_borrowed: 1024,
        ..config(Role::Server)
    };
    let mut full = opened(large);
    for call in 1..=1024 {
        accept(&mut full, &request(call, call));
    }
    let mut cancelled = opened(config(Role::Server));
    accept(&mut cancelled, &request(1, 1));
    accept(&mut cancelled, &Frame::Cancel { call: 1 });
    let mut called = opened(config(Role::Caller));
    send(&mut called, message(1));
    let late = MessageFrame {
        status: Status::DeadlinePassed,
        len: 1,
        rest: b"x",
        ..from_peer(Carrier::Reply, 1, 1)
    };
    vec![
        row(
            violation!(CallLimit, "SM2-SRV-001"),
            full,
            &request(1025, 1025),
        ),
        row(
            violation!(BadCancel, "SM2-SRV-003"),
            cancelled,
            &Frame::Cancel { call: 1 },
        ),
        row(
            violation!(UnknownCall, "SM2-SRV-002"),
            opened(config(Role::Caller)),
            &reply(1, 1),
        ),
        row(
            violation!(UnknownCall, "SM2-SRV-003"),
            opened(config(Role::Server)),
            &Frame::Cancel { call: 1 },
        ),
        row(
            violation!(BadLength, "SM2-SRV-002"),
            called,
            &Frame::Message(late),
        ),
    ]
}

//= SM2-OPN-008, SM2-TRN-004, SM2-TRN-010, SM2-WIR-001 test
//= SM2-PAY-003, SM2-PAY-001, SM2-PAY-005, SM2-MSG-003 test
//= SM2-SEG-001, SM2-SEG-002, SM2-SEG-003, SM2-SEG-004, SM2-SEG-005 test
//= SM2-RNG-001, SM2-RNG-002, SM2-RNG-009 test
#[test]
fn each_violation_ends_the_link_for_good() {
    for Row {
        violation,
        mut link,
        bytes,
        fds,
    } in rows()
    {
        let end = End::Violation(violation);
        assert_eq!(
            feed(&mut link, &bytes, &fds),
            Err(Error::Ended(end)),
            "{violation}"
        );
        let outputs = drain(&mut link);
        let close = Frame::Close(violation.code()).to_vec();
        assert_eq!(
            sent(&outputs[..1])[0].to_vec(),
            close,
            "{violation}: CLOSE is first"
        );
        assert_eq!(sent(&outputs).len(), 1, "{violation}: nothing else is sent");
        assert_eq!(outputs.last(), Some(&Output::Ended(end)), "{violation}");
        assert_dead(link, end);
    }
}

fn assert_dead(mut link: Link, end: End) {
    let close = Frame::Close(Code(0)).to_vec();
    let inputs = [
        Input::Datagram(Datagram::new(&close)),
        Input::Eof,
        Input::Drop(Fate::NoRoom),
        Input::Cancel { call: 1 },
        Input::Attach(SEGMENT),
        Input::Retire { segment: 1 },
        Input::Blocked,
        Input::Writable,
        Input::Close(Code(0)),
    ];
    assert_eq!(offer(&mut link, message(9)), Err(Error::Ended(end)));
    assert_eq!(give_back(&mut link, 1), Err(Error::Ended(end)));
    for input in inputs {
        assert_eq!(
            link.handle(NOW, input.clone()),
            Err(Error::Ended(end)),
            "{input:?}"
        );
        assert_eq!(link.poll(), None, "{input:?}");
        assert_eq!(link.end(), Some(end), "{input:?}");
    }
}

/// While the driver keeps a packet, CLOSE cannot replace it.
//= SM2-OPN-008 test
#[test]
fn a_blocked_link_ends_without_close() {
    for Row {
        violation,
        mut link,
        bytes,
        fds,
    } in rows()
    {
        link.handle(NOW, Input::Blocked).unwrap();
        let end = End::Violation(violation);
        assert_eq!(feed(&mut link, &bytes, &fds), Err(Error::Ended(end)));
        let outputs = drain(&mut link);
        assert_eq!(sent(&outputs), [], "{violation}");
        assert_eq!(outputs.last(), Some(&Output::Ended(end)), "{violation}");
    }
}

#[test]
fn no_violation_of_links_is_without_a_row() {
    let links = ViolationKind::ALL
        .iter()
        .filter(|it| (16..=20).contains(&it.code().0) || it.code().0 >= 64);
    let mut missing: BTreeSet<_> = links.copied().collect();
    missing.remove(&ViolationKind::BadWord); // in no frame: see ring_words.rs
    for row in rows() {
        missing.remove(&row.violation.kind());
    }
    assert!(missing.is_empty(), "{missing:?}");
}
