//! Links of services with rings: frames of the other lane, CANCELs, and replies in a ring.

use sm2_proto::ViolationKind::{
    BadCancel, BadLength, BadRing, Malformed, ReservedNotZero, UnknownCall, WrongLane,
};

use super::{
    ring::{DEPTH, WINDOW},
    stage::{
        LinkStage,
        Real::{Client, Server},
        Rows, Rule, all,
    },
};
use crate::{
    link::{cancel, detached, inline, kind, release},
    ring::{RawReceiver, RawSender, head, word},
};

pub(super) fn rows() -> Rows {
    let mut rows = lanes();
    rows.extend(cancels());
    rows.extend(replies());
    rows
}

impl LinkStage {
    /// Returns both rings, one to take from and one to send by, with segment 1 of the raw end
    /// attached.
    fn rings(&self) -> (RawReceiver, RawSender) {
        let sender = self.sender(4);
        let receiver = RawReceiver::new(DEPTH, WINDOW);
        receiver.offer(&self.link);
        self.victim.borrow_mut().tell("wait x 1");
        (receiver, sender)
    }

    /// The client has made call 1, whose request is too long for a cell, and which the raw end has taken.
    pub(super) fn called_by_ring(&self) -> (RawReceiver, RawSender) {
        let (receiver, sender) = self.rings();
        self.victim.borrow_mut().tell("call x 200");
        let frame = self.link.end.expect().bytes;
        assert_eq!(frame[0], kind::ATTACH, "{frame:?}");
        assert!(receiver.take(1).is_some(), "a request");
        (receiver, sender)
    }
}

fn lanes() -> Rows {
    let mut lane = Rule::new(WrongLane, "SM2-RNG-001");
    for (real, what, number) in [
        (Server, "REQUEST", kind::REQUEST),
        (Client, "REPLY", kind::REPLY),
    ] {
        lane = lane
            .fresh(real, format!("{what} on the ring lane"), move |stage| {
                let _rings = stage.rings();
                stage.send(inline(number, 1, b"x"));
            })
            .fresh(real, format!("RELEASE to a {real:?} with rings"), |stage| {
                let _rings = stage.rings();
                stage.send(release(0, &[1]));
            })
            .sent(
                real,
                format!("DETACHED to a {real:?} without rings"),
                detached(1),
            );
    }
    let twice = Rule::new(BadRing, "SM2-RNG-002")
        .fresh(Server, "RING of a caller, twice", |stage| {
            stage.rings().0.offer(&stage.link);
        })
        .fresh(Client, "RING of a server, twice", |stage| {
            stage.rings().0.offer(&stage.link);
        });
    all([lane, twice])
}

fn cancels() -> Rows {
    let twice = Rule::new(BadCancel, "SM2-RNG-011").fresh(
        Server,
        "CANCEL twice before its request",
        |stage| {
            let _rings = stage.rings();
            stage.send(cancel(3));
            stage.send(cancel(3));
        },
    );
    let many = Rule::new(UnknownCall, "SM2-RNG-011").fresh(
        Server,
        "CANCEL of more calls than have room",
        |stage| {
            let _rings = stage.rings();
            // The server's limit of open calls, and one more.
            for call in 1..=5 {
                stage.send(cancel(call));
            }
        },
    );
    all([twice, many])
}

/// Makes a head the first reply in the ring.
fn replied(rule: Rule, what: &str, head: [u8; 64]) -> Rule {
    rule.fresh(Client, what, move |stage| {
        let (_receiver, mut sender) = stage.called_by_ring();
        sender.fill(0, b"x", head);
        sender.put(1, word(1, 0, 1));
        // The client looks for its reply, and is told that there will be none.
        let heard = stage.victim.borrow_mut().ask("reply x");
        assert!(heard.contains("server"), "{heard}");
    })
}

fn replies() -> Rows {
    let with_status = |id, len, status| {
        let mut head = head(id, len);
        head[24] = status;
        head
    };
    let mut reserved = head(1, 1);
    reserved[26] = 1;
    let status = Rule::new(Malformed, "SM2-RNG-004");
    let status = replied(status, "status 4 in the ring", with_status(1, 1, 4));
    let unknown = Rule::new(UnknownCall, "SM2-RNG-004");
    let unknown = replied(unknown, "a reply to no call in the ring", head(2, 1));
    let length = Rule::new(BadLength, "SM2-RNG-004");
    let length = replied(
        length,
        "status 2 with a payload in the ring",
        with_status(1, 1, 2),
    );
    let zero = Rule::new(ReservedNotZero, "SM2-RNG-004");
    let zero = replied(zero, "a reserved byte behind the status", reserved);
    all([status, unknown, length, zero])
}
