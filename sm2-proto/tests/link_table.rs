//! The table of frames that are legal in each state, for each role, on one page.

// Shows LNK-STRICT, LNK-PHASE (test), bound: the whole table.

use crate::link_support::{
    RING, config, drain, fds_for, feed, from_peer, open_to, opened_with, sent, with_ring,
};
use sm2_proto::{
    Code, FdFacts, Instant, Period, ViolationKind,
    link::{
        Config, End, Error, FrameKind, LaneKind, Link, Role, SegmentInfo,
        wire::{Carrier, Frame, Given},
    },
    violation,
};

/// A `.` marks a frame that the state allows; its fields may still be wrong. In `opening` and
/// `open, ring`, both ends offer the ring lane. In `ended`, the lane makes no difference.
//= SM2-OPN-001, SM2-WIR-002, SM2-RNG-001 test
const EXPECTED: &str = "\
opening        Sender           Receiver         Caller           Server
Open           .                .                .                .
Attach         expected-open    expected-open    expected-open    expected-open
Detach         expected-open    expected-open    expected-open    expected-open
Data           expected-open    expected-open    expected-open    expected-open
Request        expected-open    expected-open    expected-open    expected-open
Reply          expected-open    expected-open    expected-open    expected-open
Release        expected-open    expected-open    expected-open    expected-open
Cancel         expected-open    expected-open    expected-open    expected-open
Close          .                .                .                .
Ring           expected-open    expected-open    expected-open    expected-open
Doorbell       expected-open    expected-open    expected-open    expected-open
Detached       expected-open    expected-open    expected-open    expected-open
Alive          expected-open    expected-open    expected-open    expected-open

open           Sender           Receiver         Caller           Server
Open           unexpected-open  unexpected-open  unexpected-open  unexpected-open
Attach         wrong-role       .                .                .
Detach         wrong-role       .                .                .
Data           wrong-role       .                wrong-role       wrong-role
Request        wrong-role       wrong-role       wrong-role       .
Reply          wrong-role       wrong-role       .                wrong-role
Release        .                wrong-role       .                .
Cancel         wrong-role       wrong-role       wrong-role       .
Close          .                .                .                .
Ring           wrong-lane       wrong-role       wrong-lane       wrong-lane
Doorbell       wrong-lane       wrong-lane       wrong-lane       wrong-lane
Detached       wrong-lane       wrong-role       wrong-lane       wrong-lane
Alive          wrong-role       .                wrong-role       wrong-role

open, ring     Sender           Receiver         Caller           Server
Open           unexpected-open  unexpected-open  unexpected-open  unexpected-open
Attach         wrong-role       .                .                .
Detach         wrong-role       .                .                .
Data           wrong-role       wrong-lane       wrong-role       wrong-role
Request        wrong-role       wrong-role       wrong-role       wrong-lane
Reply          wrong-role       wrong-role       wrong-lane       wrong-role
Release        wrong-lane       wrong-role       wrong-lane       wrong-lane
Cancel         wrong-role       wrong-role       wrong-role       .
Close          .                .                .                .
Ring           .                wrong-role       .                .
Doorbell       .                .                .                .
Detached       .                wrong-role       .                .
Alive          wrong-role       .                wrong-role       wrong-role

ended          Sender           Receiver         Caller           Server
Open           ended            ended            ended            ended
Attach         ended            ended            ended            ended
Detach         ended            ended            ended            ended
Data           ended            ended            ended            ended
Request        ended            ended            ended            ended
Reply          ended            ended            ended            ended
Release        ended            ended            ended            ended
Cancel         ended            ended            ended            ended
Close          ended            ended            ended            ended
Ring           ended            ended            ended            ended
Doorbell       ended            ended            ended            ended
Detached       ended            ended            ended            ended
Alive          ended            ended            ended            ended
";

/// The states with their names. Each is checked with and without an offer of the ring lane by
/// both ends, as listed.
const STATES: [(&str, State, &[bool]); 4] = [
    ("opening", State::Opening, &[true]),
    ("open", State::Open, &[false]),
    ("open, ring", State::Open, &[true]),
    ("ended", State::Ended, &[false, true]),
];

#[derive(Clone, Copy, PartialEq)]
enum State {
    Opening,
    Open,
    Ended,
}

#[test]
fn every_phase_role_lane_and_kind() {
    let mut page = Vec::new();
    for (name, state, lanes) in STATES {
        let mut lines = vec![line(name, Role::ALL.map(|role| format!("{role:?}")))];
        for kind in FrameKind::ALL {
            let row = |&ring: &bool| Role::ALL.map(|role| cell(state, ring, role, kind));
            let rows: Vec<_> = lanes.iter().map(row).collect();
            assert!(
                rows.iter().all(|it| *it == rows[0]),
                "{name}, {kind:?}: the lane makes a difference: {rows:?}"
            );
            lines.push(line(&format!("{kind:?}"), rows[0].clone()));
        }
        page.push(lines.join("\n") + "\n");
    }
    let page = page.join("\n");
    assert!(page == EXPECTED, "the matrix is now:\n{page}");
}

fn line(name: &str, cells: [String; 4]) -> String {
    let cells = cells.map(|cell| format!("{cell:<15}")).join("  ");
    format!("{name:<13}  {cells}").trim_end().to_owned()
}

fn config_on(ring: bool, role: Role) -> Config {
    let config = if ring { with_ring(role) } else { config(role) };
    // Otherwise ALIVE is illegal (SM2-QOS-012).
    let lease = Period(1);
    Config { lease, ..config }
}

fn cell(state: State, ring: bool, role: Role, kind: FrameKind) -> String {
    let config = config_on(ring, role);
    let mut link = match state {
        State::Opening => Link::new(config),
        State::Open | State::Ended => opened_with(config, &open_to(&config)),
    };
    drain(&mut link);
    if state == State::Ended {
        feed(&mut link, &Frame::Close(Code(0)).to_vec(), &[]).unwrap();
        drain(&mut link);
    }
    let (bytes, fds) = some_frame(role, kind);
    match feed(&mut link, &bytes, &fds) {
        Err(Error::Ended(End::Violation(it)))
            if matches!(
                it.kind(),
                ViolationKind::ExpectedOpen
                    | ViolationKind::UnexpectedOpen
                    | ViolationKind::WrongRole
                    | ViolationKind::WrongLane
            ) =>
        {
            it.kind().name().to_owned()
        }
        Err(Error::Ended(End::Peer(Code(0)))) => "ended".to_owned(),
        _ => ".".to_owned(),
    }
}

/// The ring lane is used only if both ends offer it.
//= SM2-OPN-004, SM2-RNG-001 test
#[test]
fn a_lane_is_used_only_if_both_offer_it() {
    for role in Role::ALL {
        for (ours, theirs) in [(false, true), (true, false), (true, true)] {
            let mut link = opened_with(config_on(ours, role), &open_to(&config_on(theirs, role)));
            let has_ring = ours && theirs;
            assert_eq!(link.lane() == LaneKind::Ring, has_ring, "{role:?}");
            let doorbell = feed(&mut link, &Frame::Doorbell.to_vec(), &[]);
            let end = Error::Ended(End::Violation(violation!(WrongLane, "SM2-RNG-001")));
            assert_eq!(doorbell, if has_ring { Ok(()) } else { Err(end) });
        }
    }
}

/// A sealed link never uses the ring lane: its ends do not offer it, and ignore the other end's
/// offer.
//= SM2-RNG-001 test
#[test]
fn a_sealed_link_has_no_ring() {
    for role in Role::ALL {
        let sealed = Config {
            sealed: true,
            ..with_ring(role)
        };
        let mut link = Link::new(sealed);
        let open = sent(&drain(&mut link))[0].to_vec();
        assert_eq!(open[24..28], [1, 0, 0, 0]);
        let link = opened_with(sealed, &open_to(&with_ring(role)));
        assert!(link.lane() == LaneKind::Socket && link.is_open());
    }
}

/// Returns a frame of this kind that passes every check that precedes the check of the state.
fn some_frame(role: Role, kind: FrameKind) -> (Vec<u8>, Vec<FdFacts>) {
    let frame = match kind {
        FrameKind::Open => open_to(&config(role)),
        FrameKind::Attach => Frame::Attach(SegmentInfo {
            id: 1,
            stride: 4096,
            slots: 1,
        }),
        FrameKind::Detach => Frame::Detach { segment: 1 },
        FrameKind::Data => Frame::Message(from_peer(Carrier::Data, 1, 1)),
        FrameKind::Request => Frame::Message(from_peer(Carrier::Request, 1, 1)),
        FrameKind::Reply => Frame::Message(from_peer(Carrier::Reply, 1, 1)),
        FrameKind::Release => Frame::Release {
            given: Given::Consumed,
            count: 0,
            rest: &[],
        },
        FrameKind::Cancel => Frame::Cancel { call: 1 },
        FrameKind::Close => Frame::Close(Code(0)),
        FrameKind::Ring => RING,
        FrameKind::Doorbell => Frame::Doorbell,
        FrameKind::Detached => Frame::Detached { segment: 1 },
        FrameKind::Alive => Frame::Alive { time: Instant(1) },
    };
    assert_eq!(frame.kind(), kind);
    (frame.to_vec(), fds_for(&frame))
}
