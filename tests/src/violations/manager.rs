//! What a node can do wrong towards its Manager.

use std::os::fd::{AsFd, OwnedFd};

use sm2_proto::{LinkId, Violation};

use super::Row;
use crate::{
    control::{self, Fields, Qos},
    memory,
    raw::RawNode,
};

/// Takes a name that is in use while the rows run.
pub const TAKEN: &str = "bystander";

pub(super) type Rows = Vec<Row<RawNode>>;

/// A row; the closure's type is known, so that its argument needs no annotation.
pub(super) fn row(
    violation: Violation,
    clause: &'static str,
    what: impl Into<String>,
    commit: impl Fn(&RawNode) + 'static,
) -> Row<RawNode> {
    Row::new(violation, clause, what, commit)
}

/// The rows; each starts with a new connection that has not greeted.
#[must_use]
pub fn rows() -> Rows {
    let mut rows = super::frames::rows();
    rows.extend(greeting());
    rows.extend(interfaces());
    rows.extend(links());
    rows
}

/// The rows for a Manager that has few descriptors to spare.
#[must_use]
pub fn starved_rows() -> Rows {
    use Violation::ControlTruncated;
    vec![row(
        ControlTruncated,
        "SM2-TRN-005",
        "more descriptors than the Manager can take",
        |node| node.send_nulls(control::hello("offender"), 200),
    )]
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
}

fn greeting() -> Rows {
    use Violation::{BadVersionRange, ExpectedHello, UnexpectedHello};
    let link = LinkId {
        epoch: 1,
        serial: 1,
    };
    let early = [
        (
            "DECLARE",
            control::declare(1, &control::publisher("t", Qos::PLAIN)),
        ),
        ("WITHDRAW", control::withdraw(1)),
        ("UNLINKED", control::unlinked(1, link, 0)),
        ("QUERY", control::query()),
    ];
    let mut rows = Rows::new();
    for (frame, bytes) in early {
        let again = bytes.clone();
        rows.push(row(
            ExpectedHello,
            "SM2-SES-001",
            format!("{frame} before HELLO"),
            move |node| node.send(&bytes),
        ));
        rows.push(row(
            ExpectedHello,
            "SM2-SES-001",
            format!("{frame} after HELLO_REFUSED"),
            move |node| {
                node.send(control::hello(TAKEN));
                let refused = [1, 0];
                assert_eq!(node.peer().expect().bytes, refused, "HELLO_REFUSED");
                node.send(&again);
            },
        ));
    }
    rows.push(row(UnexpectedHello, "SM2-SES-001", "HELLO twice", |node| {
        node.ready();
        node.send(control::hello("offender"));
    }));
    for (min, max) in [(0, 1), (0, 0), (2, 1)] {
        rows.push(row(
            BadVersionRange,
            "SM2-SES-002",
            format!("HELLO for versions {min} to {max}"),
            move |node| node.send(control::hello_versions(min, max, "offender")),
        ));
    }
    rows
}

fn interfaces() -> Rows {
    use Violation::{InterfaceNumber, UnknownInterface};
    let contract = || control::publisher("t", Qos::PLAIN);
    vec![
        row(InterfaceNumber, "SM2-IFC-001", "interface 0", move |node| {
            node.ready();
            node.send(control::declare(0, &contract()));
        }),
        row(
            InterfaceNumber,
            "SM2-IFC-001",
            "a number twice",
            move |node| {
                node.ready();
                node.declare(7, &contract());
                node.send(control::declare(7, &contract()));
            },
        ),
        row(
            InterfaceNumber,
            "SM2-IFC-001",
            "a smaller number",
            move |node| {
                node.ready();
                node.declare(7, &contract());
                node.send(control::declare(6, &contract()));
            },
        ),
        row(
            InterfaceNumber,
            "SM2-IFC-001",
            "the number of a refused interface",
            move |node| {
                node.ready();
                node.declare(1, &contract());
                let other = control::type_id("other", 1);
                let refused = control::typed_publisher("t", &other, Qos::PLAIN);
                node.send(control::declare(2, &refused));
                assert_eq!(node.peer().expect().bytes[..2], [3, 2], "DECLARE_REFUSED");
                node.send(control::declare(2, &contract()));
            },
        ),
        row(
            UnknownInterface,
            "SM2-IFC-003",
            "WITHDRAW of what was never declared",
            |node| {
                node.ready();
                node.send(control::withdraw(1));
            },
        ),
        row(
            UnknownInterface,
            "SM2-IFC-003",
            "WITHDRAW twice",
            move |node| {
                node.ready();
                node.declare(1, &contract());
                node.send(control::withdraw(1));
                assert_eq!(node.peer().expect().bytes, [6, 1], "WITHDRAWN");
                node.send(control::withdraw(1));
            },
        ),
        row(
            UnknownInterface,
            "SM2-LNK-003",
            "UNLINKED for no interface",
            |node| {
                node.ready();
                let link = LinkId {
                    epoch: 1,
                    serial: 1,
                };
                node.send(control::unlinked(1, link, 0));
            },
        ),
    ]
}

/// The offender publishes to itself, so it owns both ends of a link.
fn links() -> Rows {
    use Violation::UnknownLink;
    let linked = |node: &RawNode| {
        node.ready();
        node.declare(1, &control::publisher("own", Qos::PLAIN));
        node.declare(2, &control::subscriber("own", Qos::PLAIN));
        let id = node.linked().id;
        assert_eq!(node.linked().id, id, "the other end of the same link");
        id
    };
    vec![
        row(
            UnknownLink,
            "SM2-LNK-003",
            "UNLINKED for a link that was never made",
            move |node| {
                let LinkId { epoch, serial } = linked(node);
                let never = LinkId {
                    epoch,
                    serial: serial + 1,
                };
                node.send(control::unlinked(1, never, 0));
            },
        ),
        row(
            UnknownLink,
            "SM2-LNK-003",
            "UNLINKED for a link of another epoch",
            move |node| {
                let LinkId { epoch, serial } = linked(node);
                let other = LinkId {
                    epoch: epoch ^ 1,
                    serial,
                };
                node.send(control::unlinked(1, other, 0));
            },
        ),
        row(
            UnknownLink,
            "SM2-LNK-003",
            "a second farewell",
            move |node| {
                let id = linked(node);
                node.send(control::unlinked(1, id, 0));
                // The answer, and the other end's farewell.
                node.unlinked(id);
                node.unlinked(id);
                node.send(control::unlinked(1, id, 0));
            },
        ),
    ]
}

/// Frames that would break two rules at once, with the rule that SPEC section 10 names first.
#[must_use]
pub fn precedence() -> Rows {
    use Violation::{BadName, ExpectedHello, FdCount, FrameTooLong, NotCanonical, TrailingBytes};
    vec![
        row(
            FrameTooLong,
            "SM2-TRN-004",
            "too long, and unknown",
            |node| {
                node.send_nulls([0xff; 65_537], 2);
            },
        ),
        row(
            BadName,
            "SM2-NAM-001",
            "a bad name, and bytes after it",
            |node| {
                let bytes = Fields::new().int(0).int(1).int(1).text("").int(0).bytes();
                node.send(bytes);
            },
        ),
        row(
            TrailingBytes,
            "SM2-FRM-001",
            "too long a number, and bytes after it",
            |node| {
                node.send([5, 0x80, 0, 0]);
            },
        ),
        row(
            NotCanonical,
            "SM2-FRM-002",
            "too long a number, and a descriptor",
            |node| {
                node.send_nulls([5, 0x80, 0], 1);
            },
        ),
        row(
            FdCount,
            "SM2-TRN-005",
            "a descriptor, and no HELLO before it",
            |node| {
                node.send_nulls(control::query(), 1);
            },
        ),
        row(
            ExpectedHello,
            "SM2-SES-001",
            "an unknown interface, and no HELLO",
            |node| {
                node.send(control::withdraw(9));
            },
        ),
    ]
}
