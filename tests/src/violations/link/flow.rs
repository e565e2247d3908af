//! Messages out of order, beyond the window, or released wrongly, and calls that do not exist.

use sm2_proto::ViolationKind::{
    BadCancel, BadId, BadLength, BadRelease, BadSequence, CallLimit, UnknownCall, WindowExceeded,
};

use super::stage::{
    Real::{Client, Publisher, SealedSubscriber, Server, Subscriber, WideServer},
    Rows, Rule, WINDOW, all,
};
use crate::link::{Head, cancel, inline, kind, release};

pub(super) fn rows() -> Rows {
    let mut rows = order();
    rows.extend(ids());
    rows.extend(windows());
    rows.extend(releases());
    rows.extend(replies());
    rows.extend(cancels());
    rows
}

/// A message with this number.
fn numbered(kind: u8, sequence: u64) -> Vec<u8> {
    let head = Head::nth(kind, 1);
    Head { sequence, ..head }.bytes()
}

/// A message with this number and this id.
fn identified(kind: u8, n: u64, id: u64) -> Vec<u8> {
    let head = Head::nth(kind, n);
    Head { id, ..head }.bytes()
}

fn order() -> Rows {
    let mut rule = Rule::new(BadSequence, "SM2-MSG-001");
    for (real, kind) in [(Subscriber, kind::DATA), (Server, kind::REQUEST)] {
        for n in [0, 2, u64::MAX] {
            let what = format!("{real:?}: the first message has number {n}");
            rule = rule.sent(real, what, numbered(kind, n));
        }
        for n in [1, 3] {
            let what = format!("{real:?}: the second message has number {n}");
            rule = rule.fresh(real, what, move |stage| {
                stage.messages(1);
                stage.send(numbered(kind, n));
            });
        }
    }
    all([
        rule.fresh(Client, "Client: the first reply has number 2", |stage| {
            let id = stage.called();
            stage.send(identified(kind::REPLY, 2, id));
        }),
    ])
}

fn ids() -> Rows {
    let mut of_data = Rule::new(BadId, "SM2-MSG-002");
    let mut of_calls = Rule::new(BadId, "SM2-SRV-001");
    for id in [0, 6, 7] {
        of_data = of_data.open(
            Subscriber,
            format!("publication {id} after 7"),
            move |stage| {
                stage.send(identified(kind::DATA, 1, 7));
                stage.send(identified(kind::DATA, 2, id));
            },
        );
        of_calls = of_calls.open(Server, format!("call {id} after 7"), move |stage| {
            stage.send(identified(kind::REQUEST, 1, 7));
            stage.send(identified(kind::REQUEST, 2, id));
        });
    }
    all([of_data, of_calls])
}

fn windows() -> Rows {
    let mut exceeded = Rule::new(WindowExceeded, "SM2-MSG-003");
    for real in [Subscriber, SealedSubscriber, Server] {
        let what = format!("{real:?}: one message more than the window");
        exceeded = exceeded.fresh(real, what, |stage| stage.messages(WINDOW + 1));
    }
    let what = "one message more while the application holds some";
    let exceeded = exceeded.fresh(Subscriber, what, |stage| {
        stage.messages(WINDOW);
        stage.victim.borrow_mut().tell("hold x 2");
        stage.send(inline(kind::DATA, WINDOW + 1, b"x"));
    });
    let calls = Rule::new(CallLimit, "SM2-SRV-001");
    let what = "1,025 calls without a reply";
    all([
        exceeded,
        calls.fresh(WideServer, what, |stage| stage.messages(1025)),
    ])
}

fn releases() -> Rows {
    let lists: [(&str, Vec<u64>); 8] = [
        ("nothing", vec![]),
        ("a message that was never sent", vec![4]),
        ("message 0", vec![0]),
        ("a message twice", vec![1, 1]),
        ("messages in descending order", vec![2, 1]),
        ("one that was sent and one that was not", vec![3, 4]),
        ("513 messages", (1..=513).collect()),
        ("the last possible number", vec![u64::MAX]),
    ];
    let mut rule = Rule::new(BadRelease, "SM2-MSG-004");
    for (what, sequences) in lists {
        rule = rule.fresh(Publisher, format!("RELEASE of {what}"), move |stage| {
            stage.published(3);
            stage.send(release(0, &sequences));
        });
    }
    for fates in [[0, 0], [0, 1], [1, 0]] {
        let what = format!("RELEASE of the same message again, fates {fates:?}");
        rule = rule.fresh(Publisher, what, move |stage| {
            stage.published(3);
            fates
                .iter()
                .for_each(|&fate| stage.send(release(fate, &[2])));
        });
    }
    let rule = rule
        .fresh(
            Client,
            "RELEASE of a request that was never sent",
            |stage| {
                stage.called();
                stage.send(release(0, &[2]));
            },
        )
        .fresh(Server, "RELEASE of a reply that was never sent", |stage| {
            stage.messages(1);
            stage.send(release(0, &[1]));
        });
    let expired = Rule::new(BadRelease, "SM2-QOS-010").fresh(
        Publisher,
        "RELEASE of a message without a lifespan as expired",
        |stage| {
            stage.published(1);
            stage.send(release(2, &[1]));
        },
    );
    all([rule, expired])
}

fn replies() -> Rows {
    let unknown = Rule::new(UnknownCall, "SM2-SRV-002")
        .sent(Client, "REPLY without a call", inline(kind::REPLY, 1, b"x"))
        .fresh(Client, "REPLY for another call", |stage| {
            let id = stage.called() + 1;
            stage.send(identified(kind::REPLY, 1, id));
        })
        .fresh(Client, "REPLY twice", |stage| {
            let id = stage.called();
            stage.send(identified(kind::REPLY, 1, id));
            stage.send(identified(kind::REPLY, 2, id));
        });
    let mut length = Rule::new(BadLength, "SM2-SRV-002");
    for status in [2, 3] {
        let what = format!("REPLY with status {status} and a payload");
        length = length.fresh(Client, what, move |stage| {
            let head = Head {
                status,
                id: stage.called(),
                len: 1,
                ..Head::nth(kind::REPLY, 1)
            };
            stage.send(head.with(b"x"));
        });
    }
    all([unknown, length])
}

fn cancels() -> Rows {
    let mut unknown = Rule::new(UnknownCall, "SM2-SRV-003");
    for call in [0, 2, u64::MAX] {
        let what = format!("CANCEL of call {call}, which was never made");
        unknown = unknown.fresh(Server, what, move |stage| {
            stage.messages(1);
            stage.send(cancel(call));
        });
    }
    let twice = Rule::new(BadCancel, "SM2-SRV-003").fresh(Server, "CANCEL twice", |stage| {
        stage.messages(1);
        stage.send(cancel(1));
        stage.send(cancel(1));
    });
    all([unknown, twice])
}
