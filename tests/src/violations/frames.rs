//! Datagrams from a node that are no frames, whatever the session's state.

use sm2_proto::Violation;

use super::manager::{Rows, row};
use crate::control::{self, Qos};

/// The rows; each starts with a new connection that has not greeted.
pub(super) fn rows() -> Rows {
    let mut rows = transport();
    rows.extend(encoding());
    rows.extend(names());
    rows.extend(quality());
    rows
}

fn transport() -> Rows {
    use Violation::{FdCount, FrameTooLong};
    vec![
        row(FrameTooLong, "SM2-TRN-004", "65,537 bytes", |node| {
            node.send([0; 65_537]);
        }),
        row(
            FrameTooLong,
            "SM2-TRN-004",
            "65,537 bytes and descriptors",
            |node| {
                node.ready();
                node.send_nulls([0; 65_537], 3);
            },
        ),
        row(FdCount, "SM2-TRN-005", "HELLO with a descriptor", |node| {
            node.send_nulls(control::hello("offender"), 1);
        }),
        row(
            FdCount,
            "SM2-TRN-005",
            "QUERY with 253 descriptors",
            |node| {
                node.ready();
                node.send_nulls(control::query(), 253);
            },
        ),
        row(
            FdCount,
            "SM2-TRN-005",
            "GOODBYE with a descriptor",
            |node| {
                node.ready();
                node.send_nulls(control::goodbye(0), 1);
            },
        ),
    ]
}

fn encoding() -> Rows {
    use Violation::{Malformed, NotCanonical, TrailingBytes, UnknownFrame};
    let datagrams: [(Violation, &'static str, &'static str, &'static [u8]); 12] = [
        (UnknownFrame, "SM2-FRM-001", "frame 6", &[6]),
        (UnknownFrame, "SM2-FRM-001", "frame 16,383", &[0xff, 0x7f]),
        (Malformed, "SM2-FRM-001", "HELLO without fields", &[0]),
        (Malformed, "SM2-FRM-001", "QUERY with option 2", &[4, 2]),
        (
            Malformed,
            "SM2-FRM-001",
            "DECLARE with contract 4",
            &[1, 1, 4],
        ),
        (
            Malformed,
            "SM2-FRM-001",
            "GOODBYE with code 65,536",
            &[5, 0x80, 0x80, 0x04],
        ),
        (
            Malformed,
            "SM2-FRM-001",
            "HELLO whose name is cut short",
            &[0, 1, 1, 5, b'n'],
        ),
        (
            Malformed,
            "SM2-FRM-001",
            "UNLINKED whose link is cut short",
            &[3, 1, 1],
        ),
        (
            TrailingBytes,
            "SM2-FRM-001",
            "GOODBYE and a byte",
            &[5, 0, 0],
        ),
        (
            NotCanonical,
            "SM2-FRM-002",
            "GOODBYE with 0 in two bytes",
            &[5, 0x80, 0],
        ),
        (
            NotCanonical,
            "SM2-FRM-002",
            "GOODBYE numbered in two bytes",
            &[0x85, 0, 0],
        ),
        (
            NotCanonical,
            "SM2-FRM-002",
            "HELLO with a name's length in two bytes",
            &[0, 1, 1, 0x81, 0, b'n'],
        ),
    ];
    let to_row = |(violation, clause, what, bytes): (_, _, &str, &'static [u8])| {
        row(violation, clause, what, move |node| {
            node.send(bytes);
        })
    };
    datagrams.into_iter().map(to_row).collect()
}

fn names() -> Rows {
    const LONG: [u8; 256] = [b'a'; 256];
    let names: [&[u8]; 14] = [
        b"",
        b"/",
        b"/a",
        b"a/",
        b"a//b",
        b"..",
        b"a/../b",
        b"a.b",
        b"a b",
        b"a\0",
        b"a\n",
        "\u{e9}t\u{e9}".as_bytes(),
        &[0xff],
        &LONG,
    ];
    let hello = |name: &'static [u8]| {
        let what = format!("HELLO as {:?}", String::from_utf8_lossy(name));
        row(Violation::BadName, "SM2-NAM-001", what, move |node| {
            node.send(control::hello(name));
        })
    };
    let mut rows: Rows = names.into_iter().map(hello).collect();
    rows.push(row(
        Violation::BadName,
        "SM2-NAM-001",
        "DECLARE of topic `..`",
        |node| {
            node.ready();
            node.send(control::declare(1, &control::publisher("..", Qos::PLAIN)));
        },
    ));
    rows.push(row(
        Violation::BadName,
        "SM2-NAM-001",
        "DECLARE of type ``",
        |node| {
            node.ready();
            let contract = control::typed_publisher("t", &control::type_id("", 0), Qos::PLAIN);
            node.send(control::declare(1, &contract));
        },
    ));
    rows
}

fn quality() -> Rows {
    let plain = Qos::PLAIN;
    let contracts = [
        (
            "publisher, depth 0",
            control::publisher("t", Qos { depth: 0, ..plain }),
        ),
        (
            "publisher, depth 1,025",
            control::publisher(
                "t",
                Qos {
                    depth: 1025,
                    ..plain
                },
            ),
        ),
        (
            "publisher, latched 1,025",
            control::publisher(
                "t",
                Qos {
                    latched: 1025,
                    ..plain
                },
            ),
        ),
        (
            "subscriber, depth 0",
            control::subscriber("t", Qos { depth: 0, ..plain }),
        ),
        (
            "subscriber, depth 1,025",
            control::subscriber(
                "t",
                Qos {
                    depth: 1025,
                    ..plain
                },
            ),
        ),
        (
            "subscriber, max_borrowed 0",
            control::subscriber(
                "t",
                Qos {
                    max_borrowed: 0,
                    ..plain
                },
            ),
        ),
        (
            "subscriber, max_borrowed 1,025",
            control::subscriber(
                "t",
                Qos {
                    max_borrowed: 1025,
                    ..plain
                },
            ),
        ),
        (
            "server, depth 0",
            control::server("s", Qos { depth: 0, ..plain }),
        ),
        (
            "server, max_borrowed 0",
            control::server(
                "s",
                Qos {
                    max_borrowed: 0,
                    ..plain
                },
            ),
        ),
        (
            "client, depth 1,025",
            control::client(
                "s",
                Qos {
                    depth: 1025,
                    ..plain
                },
            ),
        ),
        (
            "client, max_borrowed 1,025",
            control::client(
                "s",
                Qos {
                    max_borrowed: 1025,
                    ..plain
                },
            ),
        ),
    ];
    let to_row = |(what, contract): (&str, Vec<u8>)| {
        row(Violation::BadQos, "SM2-FRM-003", what, move |node| {
            node.ready();
            node.send(control::declare(1, &contract));
        })
    };
    contracts.into_iter().map(to_row).collect()
}
