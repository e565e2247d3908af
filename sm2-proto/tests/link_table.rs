//! Which frame is legal when, and for whom: the whole matrix as one page.

mod link_support;

use link_support::{config, drain, fds_for, feed, from_peer, open_to, opened};
use sm2_proto::{
    Code, FdFacts, Violation,
    link::{
        End, Error, FrameKind, Link, Role, SegmentInfo,
        wire::{Carrier, Frame, Given},
    },
};

/// `.` is a frame that the state allows; what it says may still be wrong.
//= SM2-OPN-001, SM2-WIR-002 test
const EXPECTED: &str = "\
opening  Sender           Receiver         Caller           Server
Open     .                .                .                .
Attach   expected-open    expected-open    expected-open    expected-open
Detach   expected-open    expected-open    expected-open    expected-open
Data     expected-open    expected-open    expected-open    expected-open
Request  expected-open    expected-open    expected-open    expected-open
Reply    expected-open    expected-open    expected-open    expected-open
Release  expected-open    expected-open    expected-open    expected-open
Cancel   expected-open    expected-open    expected-open    expected-open
Close    .                .                .                .

open     Sender           Receiver         Caller           Server
Open     unexpected-open  unexpected-open  unexpected-open  unexpected-open
Attach   wrong-role       .                .                .
Detach   wrong-role       .                .                .
Data     wrong-role       .                wrong-role       wrong-role
Request  wrong-role       wrong-role       wrong-role       .
Reply    wrong-role       wrong-role       .                wrong-role
Release  .                wrong-role       .                .
Cancel   wrong-role       wrong-role       wrong-role       .
Close    .                .                .                .

ended    Sender           Receiver         Caller           Server
Open     ended            ended            ended            ended
Attach   ended            ended            ended            ended
Detach   ended            ended            ended            ended
Data     ended            ended            ended            ended
Request  ended            ended            ended            ended
Reply    ended            ended            ended            ended
Release  ended            ended            ended            ended
Cancel   ended            ended            ended            ended
Close    ended            ended            ended            ended
";

#[test]
fn every_phase_role_and_kind() {
    let mut page = Vec::new();
    for phase in ["opening", "open", "ended"] {
        let mut lines = vec![line(phase, Role::ALL.map(|role| format!("{role:?}")))];
        for kind in FrameKind::ALL {
            let cells = Role::ALL.map(|role| cell(phase, role, kind));
            lines.push(line(&format!("{kind:?}"), cells));
        }
        page.push(lines.join("\n") + "\n");
    }
    let page = page.join("\n");
    assert!(page == EXPECTED, "the matrix is now:\n{page}");
}

fn line(name: &str, cells: [String; 4]) -> String {
    let cells = cells.map(|cell| format!("{cell:<15}")).join("  ");
    format!("{name:<7}  {cells}").trim_end().to_owned()
}

fn cell(phase: &str, role: Role, kind: FrameKind) -> String {
    let mut link = match phase {
        "opening" => Link::new(config(role)),
        _ => opened(config(role)),
    };
    drain(&mut link);
    if phase == "ended" {
        feed(&mut link, &Frame::Close(Code(0)).to_vec(), &[]).unwrap();
        drain(&mut link);
    }
    let (bytes, fds) = some_frame(role, kind);
    match feed(&mut link, &bytes, &fds) {
        Err(Error::Ended(End::Violation(
            it @ (Violation::ExpectedOpen | Violation::UnexpectedOpen | Violation::WrongRole),
        ))) => it.name().to_owned(),
        Err(Error::Ended(End::Peer(Code(0)))) => "ended".to_owned(),
        _ => ".".to_owned(),
    }
}

/// A frame of this kind that is wrong in nothing that comes before the state.
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
    };
    assert_eq!(frame.kind(), kind);
    (frame.to_vec(), fds_for(&frame))
}
