//! The rows of the ring lane's frames.

use sm2_proto::{
    FdFacts, Machine, Seals,
    limits::RING_SEGMENTS_MAX,
    link::{
        Input, Link, Role, SegmentInfo,
        wire::{Frame, Given},
    },
    violation,
};

use super::{Row, row};
use crate::link_support::*;

fn sender() -> Link {
    opened(with_ring(Role::Sender))
}

fn receiver() -> Link {
    opened(with_ring(Role::Receiver))
}

const DETACHED: Frame<'static> = Frame::Detached {
    segment: SEGMENT.id,
};

pub(crate) fn lane_rows() -> Vec<Row> {
    let release = Frame::Release {
        given: Given::Consumed,
        count: 0,
        rest: &[],
    };
    let beyond = Frame::Attach(SegmentInfo {
        id: RING_SEGMENTS_MAX,
        ..SEGMENT
    });
    vec![
        row(
            violation!(WrongLane, "SM2-RNG-001"),
            receiver(),
            &data(1, 1),
        ),
        row(violation!(WrongLane, "SM2-RNG-001"), sender(), &release),
        row(violation!(WrongLane, "SM2-RNG-001"), super::sender(), &RING),
        row(
            violation!(WrongLane, "SM2-RNG-001"),
            super::receiver(),
            &Frame::Doorbell,
        ),
        row(
            violation!(WrongLane, "SM2-RNG-001"),
            super::sender(),
            &DETACHED,
        ),
        row(violation!(BadSegment, "SM2-RNG-003"), receiver(), &beyond),
    ]
}

pub(crate) fn file_rows() -> Vec<Row> {
    let with = |violation, change: &dyn Fn(&mut FdFacts)| {
        let mut facts = ring_file(4096);
        change(&mut facts);
        Row {
            violation,
            link: sender(),
            bytes: RING.to_vec(),
            fds: vec![facts],
        }
    };
    let ring = |depth, window| Frame::Ring { depth, window };
    let mut second = sender();
    accept(&mut second, &RING);
    vec![
        row(violation!(BadRing, "SM2-RNG-002"), sender(), &ring(0, 3)),
        row(violation!(BadRing, "SM2-RNG-002"), sender(), &ring(1025, 3)),
        row(violation!(BadRing, "SM2-RNG-002"), sender(), &ring(3, 3)),
        row(violation!(BadRing, "SM2-RNG-002"), sender(), &ring(2, 4)),
        row(violation!(BadRing, "SM2-RNG-002"), second, &RING),
        with(violation!(NotAMemfd, "SM2-RNG-002"), &|it| {
            it.regular = false
        }),
        with(violation!(SealsMissing, "SM2-RNG-002"), &|it| {
            it.seals = Seals(0x3)
        }),
        with(violation!(BadRing, "SM2-RNG-002"), &|it| {
            it.seals = Seals(0xf)
        }),
        with(violation!(BadRing, "SM2-RNG-002"), &|it| {
            it.seals = Seals(0x17)
        }),
        with(violation!(BadRing, "SM2-RNG-002"), &|it| {
            it.size_bytes = 4095
        }),
        with(violation!(BadRing, "SM2-RNG-002"), &|it| {
            it.size_bytes = 8192
        }),
    ]
}

pub(crate) fn detached_rows() -> Vec<Row> {
    let mut attached = sender();
    accept(&mut attached, &RING);
    attached.handle(NOW, Input::Attach(SEGMENT)).unwrap();
    drain(&mut attached);
    vec![
        row(
            violation!(UnknownSegment, "SM2-RNG-009"),
            sender(),
            &DETACHED,
        ),
        row(
            violation!(UnknownSegment, "SM2-RNG-009"),
            attached,
            &DETACHED,
        ),
    ]
}
