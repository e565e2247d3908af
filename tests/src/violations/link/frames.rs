//! Frames that are illegal on every link, on this link, or at this end.

use std::os::fd::AsFd;

use sm2_proto::ViolationKind::{
    BadLength, ExpectedOpen, FdCount, FrameTooLong, Malformed, ReservedNotZero, UnknownFrame,
    WrongRole,
};

use super::stage::{
    LinkStage,
    Real::{Client, Publisher, Server, Subscriber},
    Rows, Rule, all,
};
use crate::{
    link::{
        Head, alive, attach, cancel, close, detach, form, inline, kind, pooled, release, sealed,
    },
    memory,
};

pub(super) fn rows() -> Rows {
    let mut rows = transport();
    rows.extend(roles());
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
    let long = Rule::new(FrameTooLong, "SM2-TRN-004")
        .fresh(Publisher, "65,537 bytes", |stage| stage.send([0; 65_537]))
        .open(Subscriber, "65,537 bytes and descriptors", |stage| {
            stage.send_nulls([0; 65_537], 2);
        });
    let with_fds = [
        (
            "inline DATA with a descriptor",
            1,
            inline(kind::DATA, 1, b"x"),
        ),
        (
            "pooled DATA with a descriptor",
            1,
            pooled(kind::DATA, 1, 0, 0, 1),
        ),
        ("sealed DATA without", 0, sealed(kind::DATA, 1, 1)),
        ("sealed DATA with two", 2, sealed(kind::DATA, 1, 1)),
        ("ATTACH without", 0, attach(1, 4096, 1)),
        ("ATTACH with 253", 253, attach(1, 4096, 1)),
        ("DETACH with one", 1, detach(1)),
        ("CLOSE with one", 1, close(0)),
    ];
    let mut count =
        Rule::new(FdCount, "SM2-TRN-010").fresh(Subscriber, "OPEN with a descriptor", |stage| {
            stage.send_nulls(stage.greeting().bytes(), 1);
        });
    for (what, fds, bytes) in with_fds {
        count = count.open(Subscriber, what, move |stage| stage.send_nulls(&bytes, fds));
    }
    let unknown = Rule::new(UnknownFrame, "SM2-WIR-001");
    let unknown = [0, 10, 15, 20, 255]
        .into_iter()
        .fold(unknown, |rule, number| {
            rule.sent(
                Subscriber,
                format!("kind {number}"),
                [number, 0, 0, 0, 0, 0, 0, 0],
            )
        });
    all([long, count, unknown])
}

pub(super) fn starved() -> Rows {
    let what = "more descriptors than the node can take";
    all([
        Rule::new(FdCount, "SM2-TRN-010").open(Subscriber, what, |stage| {
            stage.send_nulls(sealed(kind::DATA, 1, 1), 200)
        }),
    ])
}

fn roles() -> Rows {
    let data = || ("DATA", inline(kind::DATA, 1, b"x"));
    let request = || ("REQUEST", inline(kind::REQUEST, 1, b"x"));
    let reply = || ("REPLY", inline(kind::REPLY, 1, b"x"));
    let release = || ("RELEASE", release(0, &[1]));
    let cancel = || ("CANCEL", cancel(1));
    let detach = || ("DETACH", detach(1));
    let wrong = [
        (Subscriber, vec![request(), reply(), release(), cancel()]),
        (
            Publisher,
            vec![data(), request(), reply(), detach(), cancel()],
        ),
        (Server, vec![data(), reply()]),
        (Client, vec![data(), request(), cancel()]),
    ];
    let mut rule = Rule::new(WrongRole, "SM2-WIR-002");
    for (real, frames) in wrong {
        for (frame, bytes) in frames {
            rule = rule.sent(real, format!("{frame} to a {real:?}"), bytes);
        }
    }
    let what = "ALIVE to a Subscriber that demands no lease";
    let alive = Rule::new(WrongRole, "SM2-QOS-012").sent(Subscriber, what, alive(1));
    let rule = rule.open(Publisher, "ATTACH to a Publisher", |stage| {
        stage.send_fd(attach(1, 4096, 1), &memory::segment(4096));
    });
    all([rule, alive])
}

pub(super) fn precedence() -> Rows {
    let data = Head {
        sequence: 9,
        ..Head::nth(kind::DATA, 9)
    };
    let other_form = Head { form: 3, ..data };
    let reserved = Head {
        reserved: 1,
        ..other_form
    };
    let unsealed = Head {
        form: form::SEALED,
        len: 9,
        ..data
    };
    all([
        Rule::new(UnknownFrame, "SM2-WIR-001").open(
            Subscriber,
            "unknown, with a descriptor",
            |stage| stage.send_nulls([99; 7], 1),
        ),
        Rule::new(BadLength, "SM2-WIR-001").sent(
            Subscriber,
            "too short, and reserved",
            [kind::DETACH, 1, 1, 1],
        ),
        Rule::new(ReservedNotZero, "SM2-WIR-001").sent(
            Subscriber,
            "reserved, and form 3",
            reserved.bytes(),
        ),
        Rule::new(Malformed, "SM2-PAY-001").open(
            Subscriber,
            "form 3, with a descriptor",
            move |stage| {
                stage.send_nulls(other_form.bytes(), 1);
            },
        ),
        Rule::new(FdCount, "SM2-TRN-010").fresh(
            Subscriber,
            "a descriptor, before OPEN",
            move |stage| {
                stage.send_nulls(data.bytes(), 1);
            },
        ),
        Rule::new(ExpectedOpen, "SM2-OPN-001").fresh(
            Subscriber,
            "no seal, before OPEN",
            move |stage| {
                stage.send_nulls(unsealed.bytes(), 1);
            },
        ),
    ])
}
