//! Frames that no link carries, or not this one, or not now.

use std::os::fd::AsFd;

use sm2_proto::{LinkId, Violation};

use super::{LinkStage, Real, Rows, row};
use crate::{
    link::{
        Head, Open, attach, cancel, close, detach, form, inline, kind, pooled, release, role,
        sealed, with_byte,
    },
    memory,
};

pub(super) fn rows() -> Rows {
    let mut rows = transport();
    rows.extend(opening());
    rows.extend(open_fields());
    rows.extend(roles());
    rows.extend(lengths());
    rows.extend(values());
    rows
}

impl LinkStage {
    fn send_nulls(&self, bytes: impl AsRef<[u8]>, count: usize) {
        let nulls: Vec<_> = (0..count).map(|_| memory::null()).collect();
        let fds: Vec<_> = nulls.iter().map(AsFd::as_fd).collect();
        self.link.end.send_fds(bytes, &fds);
    }
}

fn transport() -> Rows {
    use Violation::{FdCount, FrameTooLong, UnknownFrame};
    let mut rows = vec![
        row(
            Real::Subscriber,
            FrameTooLong,
            "SM2-TRN-004",
            "65,537 bytes",
            |stage| {
                stage.open();
                stage.send_nulls([0; 65_537], 2);
            },
        ),
        row(
            Real::Publisher,
            FrameTooLong,
            "SM2-TRN-004",
            "65,537 bytes",
            |stage| {
                stage.send([0; 65_537]);
            },
        ),
    ];
    let with_fds = [
        ("OPEN with a descriptor", 1, None),
        (
            "inline DATA with a descriptor",
            1,
            Some(inline(kind::DATA, 1, b"x")),
        ),
        (
            "pooled DATA with a descriptor",
            1,
            Some(pooled(kind::DATA, 1, 0, 0, 1)),
        ),
        ("sealed DATA without", 0, Some(sealed(kind::DATA, 1, 1))),
        ("sealed DATA with two", 2, Some(sealed(kind::DATA, 1, 1))),
        ("ATTACH without", 0, Some(attach(1, 4096, 1))),
        ("ATTACH with 253", 253, Some(attach(1, 4096, 1))),
        ("DETACH with one", 1, Some(detach(1))),
        ("CLOSE with one", 1, Some(close(0))),
    ];
    for (what, fds, bytes) in with_fds {
        rows.push(row(
            Real::Subscriber,
            FdCount,
            "SM2-TRN-005",
            what,
            move |stage| match &bytes {
                Some(bytes) => {
                    stage.open();
                    stage.send_nulls(bytes, fds);
                }
                None => stage.send_nulls(stage.greeting().bytes(), fds),
            },
        ));
    }
    for unknown in [0, 10, 16, 255] {
        let what = format!("kind {unknown}");
        rows.push(row(
            Real::Subscriber,
            UnknownFrame,
            "SM2-WIR-001",
            what,
            move |stage| {
                stage.open();
                stage.send([unknown, 0, 0, 0, 0, 0, 0, 0]);
            },
        ));
    }
    rows
}

pub(super) fn starved() -> Rows {
    let what = "more descriptors than the node can take";
    let starve = |stage: &LinkStage| {
        stage.open();
        stage.send_nulls(sealed(kind::DATA, 1, 1), 200);
    };
    let violation = Violation::ControlTruncated;
    vec![row(
        Real::Subscriber,
        violation,
        "SM2-TRN-005",
        what,
        starve,
    )]
}

fn opening() -> Rows {
    use Violation::{ExpectedOpen, UnexpectedOpen};
    let first = [
        (Real::Subscriber, "DATA", inline(kind::DATA, 1, b"x")),
        (Real::Subscriber, "DETACH", detach(1)),
        (Real::Publisher, "RELEASE", release(0, &[1])),
        (Real::Server, "REQUEST", inline(kind::REQUEST, 1, b"x")),
        (Real::Server, "CANCEL", cancel(1)),
        (Real::Client, "REPLY", inline(kind::REPLY, 1, b"x")),
    ];
    let mut rows = Rows::new();
    for (real, frame, bytes) in first {
        let what = format!("{frame} before OPEN");
        rows.push(row(real, ExpectedOpen, "SM2-OPN-001", what, move |stage| {
            stage.send(&bytes);
        }));
    }
    for real in [
        Real::Subscriber,
        Real::Publisher,
        Real::Server,
        Real::Client,
    ] {
        let what = format!("OPEN twice ({real:?})");
        rows.push(row(real, UnexpectedOpen, "SM2-OPN-001", what, |stage| {
            stage.open();
            stage.send(stage.greeting().bytes());
        }));
    }
    rows
}

fn open_fields() -> Rows {
    use Violation::{BadOpen, BadWindow, ReservedNotZero};
    type Change = fn(Open) -> Open;
    let fields: [(Violation, &'static str, Real, &str, Change); 17] = [
        (
            BadOpen,
            "SM2-OPN-002",
            Real::Subscriber,
            "another epoch",
            |open| Open {
                link: LinkId {
                    epoch: open.link.epoch ^ 1,
                    ..open.link
                },
                ..open
            },
        ),
        (
            BadOpen,
            "SM2-OPN-002",
            Real::Subscriber,
            "another serial",
            |open| Open {
                link: LinkId {
                    serial: open.link.serial + 1,
                    ..open.link
                },
                ..open
            },
        ),
        (
            BadOpen,
            "SM2-OPN-002",
            Real::Subscriber,
            "version 0",
            |open| Open { version: 0, ..open },
        ),
        (
            BadOpen,
            "SM2-OPN-002",
            Real::Publisher,
            "version 2",
            |open| Open { version: 2, ..open },
        ),
        (
            BadOpen,
            "SM2-OPN-002",
            Real::Subscriber,
            "its own role",
            |open| Open {
                role: role::RECEIVER,
                ..open
            },
        ),
        (
            BadOpen,
            "SM2-OPN-002",
            Real::Publisher,
            "a server's role",
            |open| Open {
                role: role::SERVER,
                ..open
            },
        ),
        (
            BadOpen,
            "SM2-OPN-002",
            Real::Client,
            "a caller's role",
            |open| Open {
                role: role::CALLER,
                ..open
            },
        ),
        (BadOpen, "SM2-OPN-002", Real::Server, "role 4", |open| {
            Open { role: 4, ..open }
        }),
        (
            BadOpen,
            "SM2-OPN-004",
            Real::Subscriber,
            "no lane",
            |open| Open { lanes: 0, ..open },
        ),
        (
            BadOpen,
            "SM2-OPN-004",
            Real::Publisher,
            "all lanes but the socket's",
            |open| Open { lanes: !1, ..open },
        ),
        (
            BadWindow,
            "SM2-OPN-003",
            Real::Subscriber,
            "window 1 of a sender",
            |open| Open { window: 1, ..open },
        ),
        (
            BadWindow,
            "SM2-OPN-003",
            Real::Publisher,
            "window 0 of a receiver",
            |open| Open { window: 0, ..open },
        ),
        (
            BadWindow,
            "SM2-OPN-003",
            Real::Publisher,
            "window 2,049 of a receiver",
            |open| Open {
                window: 2049,
                ..open
            },
        ),
        (
            BadWindow,
            "SM2-OPN-003",
            Real::Server,
            "window 0 of a caller",
            |open| Open { window: 0, ..open },
        ),
        (
            BadWindow,
            "SM2-OPN-003",
            Real::Server,
            "window 2,049 of a caller",
            |open| Open {
                window: 2049,
                ..open
            },
        ),
        (
            BadWindow,
            "SM2-OPN-003",
            Real::Client,
            "window 2^32 - 1 of a server",
            |open| Open {
                window: u32::MAX,
                ..open
            },
        ),
        (
            ReservedNotZero,
            "SM2-WIR-001",
            Real::Subscriber,
            "a reserved byte",
            |open| Open {
                reserved: 1 << 24,
                ..open
            },
        ),
    ];
    let to_row = |(violation, clause, real, what, change): (_, _, _, &str, Change)| {
        row(
            real,
            violation,
            clause,
            format!("OPEN with {what}"),
            move |stage| {
                stage.send(change(stage.greeting()).bytes());
            },
        )
    };
    fields.into_iter().map(to_row).collect()
}

fn roles() -> Rows {
    let wrong = [
        (Real::Subscriber, "REQUEST", inline(kind::REQUEST, 1, b"x")),
        (Real::Subscriber, "REPLY", inline(kind::REPLY, 1, b"x")),
        (Real::Subscriber, "RELEASE", release(0, &[1])),
        (Real::Subscriber, "CANCEL", cancel(1)),
        (Real::Publisher, "DATA", inline(kind::DATA, 1, b"x")),
        (Real::Publisher, "REQUEST", inline(kind::REQUEST, 1, b"x")),
        (Real::Publisher, "REPLY", inline(kind::REPLY, 1, b"x")),
        (Real::Publisher, "DETACH", detach(1)),
        (Real::Publisher, "CANCEL", cancel(1)),
        (Real::Server, "DATA", inline(kind::DATA, 1, b"x")),
        (Real::Server, "REPLY", inline(kind::REPLY, 1, b"x")),
        (Real::Client, "DATA", inline(kind::DATA, 1, b"x")),
        (Real::Client, "REQUEST", inline(kind::REQUEST, 1, b"x")),
        (Real::Client, "CANCEL", cancel(1)),
    ];
    let mut rows = Rows::new();
    for (real, frame, bytes) in wrong {
        let what = format!("{frame} to a {real:?}");
        let violation = Violation::WrongRole;
        rows.push(row(real, violation, "SM2-WIR-002", what, move |stage| {
            stage.open();
            stage.send(&bytes);
        }));
    }
    let violation = Violation::WrongRole;
    rows.push(row(
        Real::Publisher,
        violation,
        "SM2-WIR-002",
        "ATTACH to a Publisher",
        |stage| {
            stage.open();
            stage.send_fd(attach(1, 4096, 1), &memory::segment(4096));
        },
    ));
    rows
}

fn lengths() -> Rows {
    let head = Head::nth(kind::DATA, 1);
    let frames = [
        (
            Real::Subscriber,
            "DETACH of 7 bytes",
            detach(1)[..7].to_vec(),
        ),
        (
            Real::Subscriber,
            "CLOSE of 9 bytes",
            [close(0), vec![0]].concat(),
        ),
        (Real::Subscriber, "CLOSE of 1 byte", vec![kind::CLOSE]),
        (
            Real::Subscriber,
            "DATA of 47 bytes",
            head.bytes()[..47].to_vec(),
        ),
        (
            Real::Subscriber,
            "inline DATA shorter than it says",
            Head { len: 2, ..head }.with(b"x"),
        ),
        (
            Real::Subscriber,
            "inline DATA longer than it says",
            Head { len: 1, ..head }.with(b"xy"),
        ),
        (
            Real::Subscriber,
            "pooled DATA with bytes behind it",
            [pooled(kind::DATA, 1, 1, 0, 1), vec![0]].concat(),
        ),
        (
            Real::Publisher,
            "RELEASE of 7 bytes",
            release(0, &[])[..7].to_vec(),
        ),
        (
            Real::Publisher,
            "RELEASE shorter than it says",
            release(0, &[1, 2])[..16].to_vec(),
        ),
        (
            Real::Publisher,
            "RELEASE longer than it says",
            [release(0, &[1]), vec![0; 8]].concat(),
        ),
        (Real::Server, "CANCEL of 15 bytes", cancel(1)[..15].to_vec()),
        (
            Real::Client,
            "REPLY of 47 bytes",
            Head::nth(kind::REPLY, 1).bytes()[..47].to_vec(),
        ),
    ];
    let mut rows = Rows::new();
    for (real, what, bytes) in frames {
        let violation = Violation::BadLength;
        rows.push(row(real, violation, "SM2-WIR-001", what, move |stage| {
            stage.open();
            stage.send(&bytes);
        }));
    }
    let violation = Violation::BadLength;
    rows.push(row(
        Real::Subscriber,
        violation,
        "SM2-WIR-001",
        "OPEN of 33 bytes",
        |stage| {
            stage.send([stage.greeting().bytes(), vec![0]].concat());
        },
    ));
    rows.push(row(
        Real::Subscriber,
        violation,
        "SM2-WIR-001",
        "ATTACH of 20 bytes",
        |stage| {
            stage.open();
            stage.send_fd(&attach(1, 4096, 1)[..20], &memory::segment(4096));
        },
    ));
    rows.push(row(
        Real::Subscriber,
        violation,
        "SM2-PAY-001",
        "61,441 inline bytes",
        |stage| {
            stage.open();
            stage.send(inline(kind::DATA, 1, &vec![0; 61_441]));
        },
    ));
    rows
}

/// Reserved bytes, and values that no field has.
fn values() -> Rows {
    use Violation::{Malformed, ReservedNotZero};
    let data = || inline(kind::DATA, 1, b"x");
    let reserved = [
        (Real::Subscriber, "DATA", 12, data()),
        (Real::Subscriber, "status of DATA", 2, data()),
        (Real::Subscriber, "segment of inline DATA", 4, data()),
        (Real::Subscriber, "slot of inline DATA", 8, data()),
        (Real::Subscriber, "DETACH", 3, detach(1)),
        (Real::Subscriber, "CLOSE", 1, close(0)),
        (Real::Subscriber, "CLOSE", 7, close(0)),
        (Real::Publisher, "RELEASE", 4, release(0, &[1])),
        (Real::Server, "CANCEL", 7, cancel(1)),
        (
            Real::Server,
            "status of REQUEST",
            2,
            inline(kind::REQUEST, 1, b"x"),
        ),
    ];
    let mut rows = Rows::new();
    for (real, what, offset, bytes) in reserved {
        let what = format!("{what}, byte {offset}");
        let bytes = with_byte(bytes, offset, 1);
        rows.push(row(
            real,
            ReservedNotZero,
            "SM2-WIR-001",
            what,
            move |stage| {
                stage.open();
                stage.send(&bytes);
            },
        ));
    }
    for offset in [1, 3, 20, 23] {
        let what = format!("ATTACH, byte {offset}");
        rows.push(row(
            Real::Subscriber,
            ReservedNotZero,
            "SM2-WIR-001",
            what,
            move |stage| {
                stage.open();
                let bytes = with_byte(attach(1, 4096, 1), offset, 1);
                stage.send_fd(bytes, &memory::segment(4096));
            },
        ));
    }
    let malformed = [
        (
            Real::Subscriber,
            "SM2-PAY-004",
            "form 3",
            Head {
                form: 3,
                ..Head::nth(kind::DATA, 1)
            }
            .bytes(),
        ),
        (
            Real::Server,
            "SM2-PAY-004",
            "form 255",
            Head {
                form: 255,
                ..Head::nth(kind::REQUEST, 1)
            }
            .bytes(),
        ),
        (Real::Publisher, "SM2-MSG-004", "fate 2", release(2, &[1])),
        (
            Real::Client,
            "SM2-SRV-003",
            "status 4",
            Head {
                status: 4,
                ..Head::nth(kind::REPLY, 1)
            }
            .bytes(),
        ),
    ];
    for (real, clause, what, bytes) in malformed {
        rows.push(row(real, Malformed, clause, what, move |stage| {
            stage.open();
            stage.send(&bytes);
        }));
    }
    rows
}

pub(super) fn precedence() -> Rows {
    use Violation::{BadLength, ExpectedOpen, FdCount, Malformed, ReservedNotZero, UnknownFrame};
    let data = Head {
        sequence: 9,
        ..Head::nth(kind::DATA, 9)
    };
    let unsealed = Head {
        form: form::SEALED,
        len: 9,
        ..data
    };
    vec![
        row(
            Real::Subscriber,
            UnknownFrame,
            "SM2-WIR-001",
            "unknown, with a descriptor",
            |stage| {
                stage.open();
                stage.send_nulls([99; 7], 1);
            },
        ),
        row(
            Real::Subscriber,
            BadLength,
            "SM2-WIR-001",
            "too short, reserved not zero",
            |stage| {
                stage.open();
                stage.send([kind::DETACH, 1, 1, 1]);
            },
        ),
        row(
            Real::Subscriber,
            ReservedNotZero,
            "SM2-WIR-001",
            "reserved, and form 3",
            move |stage| {
                stage.open();
                stage.send(
                    Head {
                        form: 3,
                        reserved: 1,
                        ..data
                    }
                    .bytes(),
                );
            },
        ),
        row(
            Real::Subscriber,
            Malformed,
            "SM2-PAY-004",
            "form 3, with a descriptor",
            move |stage| {
                stage.open();
                stage.send_nulls(Head { form: 3, ..data }.bytes(), 1);
            },
        ),
        row(
            Real::Subscriber,
            FdCount,
            "SM2-TRN-005",
            "a descriptor, before OPEN",
            move |stage| {
                stage.send_nulls(data.bytes(), 1);
            },
        ),
        row(
            Real::Subscriber,
            ExpectedOpen,
            "SM2-OPN-001",
            "no seal, before OPEN",
            move |stage| {
                stage.send_nulls(unsealed.bytes(), 1);
            },
        ),
    ]
}
