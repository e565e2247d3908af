//! Violations by a node that resumes its session with a new Manager.

use sm2_proto::{
    LinkId,
    ViolationKind::{BadClaim, UnexpectedClaim, UnexpectedHello, UnknownInterface},
};

use super::manager_rows::{Rows, Rule, all};
use crate::{
    control::{self, Claim, Qos},
    raw::RawNode,
};

/// A claim of a link that no Manager of the tests has made.
const CLAIM: Claim = Claim {
    interface: 7,
    link: LinkId {
        epoch: 1,
        serial: 1,
    },
    key: 1,
    version: 1,
    reliable: false,
    sealed: false,
};

impl RawNode {
    /// Reconnects, and declares interface 7. Returns the Manager's epoch.
    fn back(&self) -> u64 {
        let (_, epoch) = self.greet_again("offender");
        self.declare(7, &control::publisher("t", Qos::PLAIN));
        epoch
    }

    fn claim(&self, change: impl FnOnce(&mut Claim)) {
        let mut claim = CLAIM;
        change(&mut claim);
        self.send(claim.bytes());
    }
}

/// The rows; each starts with a new connection that has not greeted.
pub(super) fn rows() -> Rows {
    let unexpected = Rule::new(UnexpectedClaim, "SM2-RES-003")
        .row("CLAIM of a node that has nothing to resume", |node| {
            node.ready();
            node.send(control::declare(7, &control::publisher("t", Qos::PLAIN)));
            node.next();
            node.claim(|_| {});
        })
        .row("CLAIMED of a node that has nothing to resume", |node| {
            node.ready();
            node.send(control::claimed());
        })
        .row("CLAIM after CLAIMED", |node| {
            node.back();
            node.send(control::claimed());
            node.claim(|_| {});
        })
        .row("CLAIMED twice", |node| {
            node.back();
            node.send(control::claimed());
            node.send(control::claimed());
        });
    let unknown = Rule::new(UnknownInterface, "SM2-RES-003")
        .row("CLAIM for an interface that is not declared", |node| {
            node.back();
            node.claim(|claim| claim.interface = 8);
        })
        .row("CLAIM for an interface that is withdrawn", |node| {
            node.back();
            node.send(control::withdraw(7));
            assert_eq!(node.peer().expect().bytes, [6, 7], "WITHDRAWN");
            node.claim(|_| {});
        });
    let bad = Rule::new(BadClaim, "SM2-RES-003")
        .row("CLAIM of a link of this Manager", |node| {
            let epoch = node.back();
            node.claim(|claim| claim.link.epoch = epoch);
        })
        .row("CLAIM twice", |node| {
            node.back();
            node.claim(|_| {});
            node.claim(|_| {});
        })
        .row("CLAIM twice with another key", |node| {
            node.back();
            node.claim(|_| {});
            node.claim(|claim| claim.key = 2);
        })
        .row("CLAIM for version 0", |node| {
            node.back();
            node.claim(|claim| claim.version = 0);
        })
        .row("CLAIM for version 2", |node| {
            node.back();
            node.claim(|claim| claim.version = 2);
        });
    let hello = Rule::new(UnexpectedHello, "SM2-SES-001").row("HELLO while resuming", |node| {
        node.back();
        node.send(control::hello_again("offender"));
    });
    all([unexpected, unknown, bad, hello])
}
