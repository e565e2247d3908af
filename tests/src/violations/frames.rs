//! Datagrams from a node that are not frames, whatever the state of the session.

use sm2_proto::ViolationKind::{
    BadName, BadQos, FdCount, FrameTooLong, Malformed, NotCanonical, TrailingBytes, UnknownFrame,
};

use super::manager_rows::{Rows, Rule, all};
use crate::control::{self, Qos};

/// The rows; each starts with a new connection that has not greeted.
pub(super) fn rows() -> Rows {
    let mut rows = transport();
    rows.extend(encoding());
    rows.extend(names());
    rows.extend(quality());
    rows
}

impl Rule {
    /// A datagram before any other.
    pub(super) fn sent(self, what: impl Into<String>, bytes: impl Into<Vec<u8>>) -> Self {
        let bytes = bytes.into();
        self.row(what, move |node| node.send(&bytes))
    }
}

fn transport() -> Rows {
    let long = Rule::new(FrameTooLong, "SM2-TRN-004")
        .sent("65,537 bytes", [0; 65_537])
        .row("65,537 bytes and descriptors", |node| {
            node.ready();
            node.send_nulls([0; 65_537], 3);
        });
    let count = Rule::new(FdCount, "SM2-TRN-010")
        .row("HELLO with a descriptor", |node| {
            node.send_nulls(control::hello("offender"), 1);
        })
        .row("QUERY with 253 descriptors", |node| {
            node.ready();
            node.send_nulls(control::query(), 253);
        })
        .row("GOODBYE with a descriptor", |node| {
            node.ready();
            node.send_nulls(control::goodbye(0), 1);
        })
        .row("COUNTERS without one", |node| {
            node.ready();
            node.send(control::counters());
        })
        .row("COUNTERS with two", |node| {
            node.ready();
            node.send_nulls(control::counters(), 2);
        });
    all([long, count])
}

fn encoding() -> Rows {
    all([
        Rule::new(UnknownFrame, "SM2-FRM-001")
            .sent("frame 16", [16])
            .sent("frame 16,383", [0xff, 0x7f])
            .sent("a number cut short", [0x80]),
        Rule::new(Malformed, "SM2-FRM-001")
            .sent("HELLO without fields", [0])
            .sent("QUERY with option 2", [4, 2])
            .sent("QUERY after key 5", [4, 1, 5])
            .sent("HELLO with `resuming` 2", [0, 1, 1, 1, b'n', 2])
            .sent("DECLARE with contract 4", [1, 1, 4])
            .sent("GOODBYE with code 65,536", [5, 0x80, 0x80, 0x04])
            .sent("HELLO whose name is cut short", [0, 1, 1, 5, b'n'])
            .sent("UNLINKED whose link is cut short", [3, 1, 1]),
        Rule::new(TrailingBytes, "SM2-FRM-001").sent("GOODBYE and a byte", [5, 0, 0]),
        Rule::new(NotCanonical, "SM2-FRM-002")
            .sent("GOODBYE with 0 in two bytes", [5, 0x80, 0])
            .sent("GOODBYE numbered in two bytes", [0x85, 0, 0])
            .sent(
                "HELLO with a length in two bytes",
                [0, 1, 1, 0x81, 0, b'n', 0],
            ),
    ])
}

fn names() -> Rows {
    const LONG: [u8; 256] = [b'a'; 256];
    let accents = "\u{e9}t\u{e9}".as_bytes();
    let names: [&[u8]; 13] = [
        b"", b"/", b"/a", b"a/", b"a//b", b"..", b"a/../b", b"a.b", b"a b", b"a\0", b"a\n",
        accents, &LONG,
    ];
    let mut rule = Rule::new(BadName, "SM2-NAM-001");
    for name in names {
        let what = format!("HELLO as {:?}", String::from_utf8_lossy(name));
        rule = rule.sent(what, control::hello(name));
    }
    let rule = rule
        .row("DECLARE of topic `..`", |node| {
            node.ready();
            node.send(control::declare(1, &control::publisher("..", Qos::PLAIN)));
        })
        .row("DECLARE of type ``", |node| {
            node.ready();
            let contract = control::typed_publisher("t", &control::type_id("", 0), Qos::PLAIN);
            node.send(control::declare(1, &contract));
        });
    let not_utf8 =
        Rule::new(BadName, "SM2-FRM-001").sent("HELLO as the byte 0xff", control::hello([0xff]));
    all([rule, not_utf8])
}

fn quality() -> Rows {
    let publisher: fn(Qos) -> Vec<u8> = |qos| control::publisher("t", qos);
    let subscriber: fn(Qos) -> Vec<u8> = |qos| control::subscriber("t", qos);
    let server: fn(Qos) -> Vec<u8> = |qos| control::server("s", qos);
    let client: fn(Qos) -> Vec<u8> = |qos| control::client("s", qos);
    type Change = (&'static str, fn(&mut Qos));
    let changes: [Change; 5] = [
        ("depth 0", |qos| qos.depth = 0),
        ("depth 1,025", |qos| qos.depth = 1025),
        ("latched 1,025", |qos| qos.latched = 1025),
        ("max_borrowed 0", |qos| qos.max_borrowed = 0),
        ("max_borrowed 1,025", |qos| qos.max_borrowed = 1025),
    ];
    let [few, many, latched, none, more] = changes;
    let kinds = [
        ("publisher", publisher, vec![few, many, latched]),
        ("subscriber", subscriber, vec![few, many, none, more]),
        ("server", server, vec![few, many, none, more]),
        ("client", client, vec![few, many, none, more]),
    ];
    let mut rule = Rule::new(BadQos, "SM2-FRM-003");
    for (kind, contract, changes) in kinds {
        for (what, change) in changes {
            let mut qos = Qos::PLAIN;
            change(&mut qos);
            let declare = control::declare(1, &contract(qos));
            rule = rule.row(format!("{kind}, {what}"), move |node| {
                node.ready();
                node.send(&declare);
            });
        }
    }
    all([rule])
}
