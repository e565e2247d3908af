//! OPEN that comes late, or twice, or has illegal fields.

use sm2_proto::ViolationKind::{BadOpen, BadWindow, ExpectedOpen, UnexpectedOpen};

use super::stage::{
    Real::{self, Client, Publisher, Server, Subscriber},
    Rows, Rule, all,
};
use crate::link::{Open, cancel, detach, inline, kind, release, role};

pub(super) fn rows() -> Rows {
    let mut rows = order();
    rows.extend(fields());
    rows
}

fn order() -> Rows {
    let first = [
        (Subscriber, "DATA", inline(kind::DATA, 1, b"x")),
        (Subscriber, "DETACH", detach(1)),
        (Publisher, "RELEASE", release(0, &[1])),
        (Server, "REQUEST", inline(kind::REQUEST, 1, b"x")),
        (Server, "CANCEL", cancel(1)),
        (Client, "REPLY", inline(kind::REPLY, 1, b"x")),
    ];
    let mut expected = Rule::new(ExpectedOpen, "SM2-OPN-001");
    for (real, frame, bytes) in first {
        let what = format!("{frame} before OPEN");
        expected = expected.fresh(real, what, move |stage| stage.send(&bytes));
    }
    let mut unexpected = Rule::new(UnexpectedOpen, "SM2-OPN-001");
    for real in [Subscriber, Publisher, Server, Client] {
        let what = format!("OPEN twice ({real:?})");
        unexpected = unexpected.open(real, what, |stage| stage.send(stage.greeting().bytes()));
    }
    all([expected, unexpected])
}

/// A wrong OPEN: the real end that receives it, its description, and the change that makes it wrong.
type Change = (Real, &'static str, fn(&mut Open));

/// OPEN with one field changed.
fn with(rule: Rule, changes: &[Change]) -> Rule {
    changes.iter().fold(rule, |rule, &(real, what, change)| {
        rule.fresh(real, format!("OPEN with {what}"), move |stage| {
            let mut open = stage.greeting();
            change(&mut open);
            stage.send(open.bytes());
        })
    })
}

fn fields() -> Rows {
    let who = with(
        Rule::new(BadOpen, "SM2-OPN-002"),
        &[
            (Subscriber, "another epoch", |it| it.link.epoch ^= 1),
            (Subscriber, "another serial", |it| it.link.serial += 1),
            (Subscriber, "version 0", |it| it.version = 0),
            (Publisher, "version 2", |it| it.version = 2),
            (Subscriber, "its own role", |it| it.role = role::RECEIVER),
            (Publisher, "a server's role", |it| it.role = role::SERVER),
            (Client, "a caller's role", |it| it.role = role::CALLER),
            (Server, "role 4", |it| it.role = 4),
        ],
    );
    let lanes = with(
        Rule::new(BadOpen, "SM2-OPN-004"),
        &[
            (Subscriber, "no lane", |it| it.lanes = 0),
            (Publisher, "all lanes but the socket's", |it| it.lanes = !1),
        ],
    );
    let windows = with(
        Rule::new(BadWindow, "SM2-OPN-003"),
        &[
            (Subscriber, "window 1 of a sender", |it| it.window = 1),
            (Publisher, "window 0 of a receiver", |it| it.window = 0),
            (Publisher, "window 2,049 of a receiver", |it| {
                it.window = 2049
            }),
            (Server, "window 0 of a caller", |it| it.window = 0),
            (Server, "window 2,049 of a caller", |it| it.window = 2049),
            (Client, "window 2^32 - 1 of a server", |it| it.window = !0),
        ],
    );
    let max_lens = with(
        Rule::new(BadOpen, "SM2-OPN-005"),
        &[
            (Subscriber, "max_len 1 of a sender", |it| it.max_len = 1),
            (Publisher, "max_len 0 of a receiver", |it| it.max_len = 0),
            (Publisher, "max_len 2^30 + 1 of a receiver", |it| {
                it.max_len = (1 << 30) + 1;
            }),
            (Server, "max_len 0 of a caller", |it| it.max_len = 0),
            (Client, "max_len 2^32 - 1 of a server", |it| it.max_len = !0),
        ],
    );
    let publications = with(
        Rule::new(BadOpen, "SM2-OPN-006"),
        &[
            (Subscriber, "published, without publisher", |it| {
                it.published = 1
            }),
            (Publisher, "the publisher of a receiver", |it| {
                it.publisher = 1
            }),
            (Publisher, "published of a receiver", |it| it.published = 1),
            (Server, "the publisher of a caller", |it| it.publisher = !0),
            (Client, "published of a server", |it| it.published = !0),
        ],
    );
    all([who, lanes, windows, max_lens, publications])
}
