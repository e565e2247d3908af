//! Violations by a node towards its Manager.

use std::os::fd::{AsFd, OwnedFd};

use sm2_proto::{
    LinkId,
    ViolationKind::{
        BadInterfaceId, BadName, BadVersionRange, ExpectedHello, FdCount, FrameTooLong,
        NotCanonical, TrailingBytes, UnexpectedHello, UnknownInterface, UnknownLink,
    },
};

use super::manager_rows::{Rows, Rule, all};
use crate::{
    control::{self, Fields, Qos},
    memory,
    raw::RawNode,
};

/// A name that is in use while the rows run.
pub const TAKEN: &str = "bystander";

/// The rows; each starts with a new connection that has not greeted.
#[must_use]
pub fn rows() -> Rows {
    let mut rows = super::frames::rows();
    rows.extend(greeting());
    rows.extend(numbers());
    rows.extend(interfaces());
    rows.extend(links());
    rows.extend(super::takeover::rows());
    rows.extend(super::questions::rows());
    rows
}

/// The rows for a Manager that has few descriptors to spare.
#[must_use]
pub fn starved_rows() -> Rows {
    let what = "more descriptors than the Manager can take";
    all([Rule::new(FdCount, "SM2-TRN-010").row(what, |node| {
        node.send_nulls(control::hello("offender"), 200)
    })])
}

impl RawNode {
    /// Sends a frame with `count` descriptors.
    pub(super) fn send_nulls(&self, bytes: impl AsRef<[u8]>, count: usize) {
        let nulls: Vec<OwnedFd> = (0..count).map(|_| memory::null()).collect();
        let fds: Vec<_> = nulls.iter().map(AsFd::as_fd).collect();
        self.send_fds(bytes, &fds);
    }

    pub(super) fn ready(&self) {
        self.greet("offender");
    }

    /// Greets, and declares interface 7.
    fn declared(&self) {
        self.ready();
        self.declare(7, &contract());
    }

    /// Greets, and owns both ends of a link: it publishes to itself.
    fn linked_to_itself(&self) -> LinkId {
        self.ready();
        self.declare(1, &control::publisher("own", Qos::PLAIN));
        self.declare(2, &control::subscriber("own", Qos::PLAIN));
        let id = self.linked().id;
        assert_eq!(self.linked().id, id, "the other end of the same link");
        id
    }
}

fn contract() -> Vec<u8> {
    control::publisher("t", Qos::PLAIN)
}

fn greeting() -> Rows {
    let link = LinkId {
        epoch: 1,
        serial: 1,
    };
    let early = [
        ("DECLARE", control::declare(1, &contract())),
        ("WITHDRAW", control::withdraw(1)),
        ("UNLINKED", control::unlinked(1, link, 0)),
        ("QUERY", control::query()),
        ("CLAIMED", control::claimed()),
        ("WATCH", control::watch(0)),
        ("INSPECT", control::inspect(1)),
        ("DESCRIBE", control::describe(&control::bytes_type())),
        ("RELOAD", control::reload()),
    ];
    let mut expected = Rule::new(ExpectedHello, "SM2-SES-001");
    for (frame, bytes) in early {
        expected = expected.sent(format!("{frame} before HELLO"), &*bytes);
        expected = expected.row(format!("{frame} after HELLO_REFUSED"), move |node| {
            node.send(control::hello(TAKEN));
            assert_eq!(node.peer().expect().bytes, [1, 0], "HELLO_REFUSED");
            node.send(&bytes);
        });
    }
    let unexpected = Rule::new(UnexpectedHello, "SM2-SES-001").row("HELLO twice", |node| {
        node.ready();
        node.send(control::hello("offender"));
    });
    let mut range = Rule::new(BadVersionRange, "SM2-SES-002");
    for (min, max) in [(0, 1), (0, 0), (2, 1)] {
        let what = format!("HELLO for versions {min} to {max}");
        range = range.sent(what, control::hello_versions(min, max, "offender"));
    }
    all([expected, unexpected, range])
}

fn numbers() -> Rows {
    let rule = Rule::new(BadInterfaceId, "SM2-IFC-001")
        .row("interface 0", |node| {
            node.ready();
            node.send(control::declare(0, &contract()));
        })
        .row("a number twice", |node| {
            node.declared();
            node.send(control::declare(7, &contract()));
        })
        .row("a smaller number", |node| {
            node.declared();
            node.send(control::declare(6, &contract()));
        })
        .row("the number of a refused interface", |node| {
            node.declared();
            let other = control::type_id("other", 1);
            let refused = control::typed_publisher("t", &other, Qos::PLAIN);
            node.send(control::declare(8, &refused));
            assert_eq!(node.peer().expect().bytes[..2], [3, 8], "DECLARE_REFUSED");
            node.send(control::declare(8, &contract()));
        });
    all([rule])
}

fn interfaces() -> Rows {
    let withdraw = Rule::new(UnknownInterface, "SM2-IFC-003")
        .row("WITHDRAW of what was never declared", |node| {
            node.ready();
            node.send(control::withdraw(1));
        })
        .row("WITHDRAW twice", |node| {
            node.declared();
            node.send(control::withdraw(7));
            assert_eq!(node.peer().expect().bytes, [6, 7], "WITHDRAWN");
            node.send(control::withdraw(7));
        });
    let unlinked =
        Rule::new(UnknownInterface, "SM2-LNK-003").row("UNLINKED for no interface", |node| {
            let id = node.linked_to_itself();
            node.send(control::unlinked(3, id, 0));
        });
    all([withdraw, unlinked])
}

fn links() -> Rows {
    let rule = Rule::new(UnknownLink, "SM2-LNK-003")
        .row("UNLINKED for a link that was never made", |node| {
            let LinkId { epoch, serial } = node.linked_to_itself();
            let serial = serial + 1;
            node.send(control::unlinked(1, LinkId { epoch, serial }, 0));
        })
        .row("UNLINKED for a link of another epoch", |node| {
            let LinkId { epoch, serial } = node.linked_to_itself();
            let epoch = epoch ^ 1;
            node.send(control::unlinked(1, LinkId { epoch, serial }, 0));
        })
        .row("a second farewell", |node| {
            let id = node.linked_to_itself();
            node.send(control::unlinked(1, id, 0));
            // The answer, and the other end's farewell.
            node.unlinked(id);
            node.unlinked(id);
            node.send(control::unlinked(1, id, 0));
        });
    all([rule])
}

/// Frames that would break two rules at once, with the rule that SPEC section 10 names first.
#[must_use]
pub fn precedence() -> Rows {
    let bad_name = Fields::new()
        .int(0)
        .int(1)
        .int(1)
        .text("")
        .int(0)
        .int(0)
        .bytes();
    all([
        Rule::new(FrameTooLong, "SM2-TRN-004").row("too long, and unknown", |node| {
            node.send_nulls([0xff; 65_537], 2)
        }),
        Rule::new(BadName, "SM2-NAM-001").sent("a bad name, and bytes after it", bad_name),
        Rule::new(TrailingBytes, "SM2-FRM-001")
            .sent("too long a number, and bytes after it", [5, 0x80, 0, 0]),
        Rule::new(NotCanonical, "SM2-FRM-002").row("too long a number, and a descriptor", |node| {
            node.send_nulls([5, 0x80, 0], 1)
        }),
        Rule::new(FdCount, "SM2-TRN-010").row("a descriptor, before HELLO", |node| {
            node.send_nulls(control::query(), 1)
        }),
        Rule::new(ExpectedHello, "SM2-SES-001")
            .sent("an unknown interface, before HELLO", control::withdraw(9)),
    ])
}
