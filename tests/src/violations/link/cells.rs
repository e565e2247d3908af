//! Words of messages in cells, and cells, that no honest end would write.

use sm2_proto::{
    ViolationKind::{BadId, BadLength, BadWord, ReservedNotZero, UnknownCall},
    link::{At, RingMemory},
};

use super::stage::{
    LinkStage,
    Real::{self, BestEffort, Client, Expiring, Publisher, ReliablePublisher, Subscriber},
    Rows, Rule, all,
};
use crate::ring::{RawReceiver, RawSender, cell_word, head, word};

pub(super) fn rows() -> Rows {
    let mut rows = forward_words();
    rows.extend(contents());
    rows.extend(replies());
    rows.extend(swapped());
    rows.extend(given_back());
    rows
}

/// A row on a ring with messages that the subscriber has not taken.
fn put(
    rule: Rule,
    real: Real,
    what: impl Into<String>,
    commit: impl Fn(&mut RawSender) + 'static,
) -> Rule {
    rule.fresh(real, what, move |stage| {
        let mut sender = stage.sender(4);
        commit(&mut sender);
        stage.drain();
    })
}

fn forward_words() -> Rows {
    let right = cell_word(1, 0, 1);
    let words = [
        ("105 bytes", cell_word(105, 0, 1)),
        ("255 bytes", cell_word(255, 0, 1)),
        ("status 4", cell_word(1, 4, 1)),
        ("bit 16", right | 1 << 16),
        ("bit 29", right | 1 << 29),
        ("no bit 30", right & !(1 << 30)),
        ("sequence number 0", cell_word(1, 0, 0)),
        ("sequence number 2", cell_word(1, 0, 2)),
    ];
    let mut rule = Rule::new(BadWord, "SM2-RNG-007");
    for real in [Subscriber, BestEffort] {
        for (what, bits) in words {
            let what = format!("a message in a cell: {what} ({real:?})");
            rule = put(rule, real, what, move |sender| {
                sender.fill_cell(1, 1, b"x");
                sender.put(1, bits);
            });
        }
    }
    let expiring = put(
        Rule::new(BadWord, "SM2-RNG-013"),
        Expiring,
        "a message in a cell of a publisher with a lifespan",
        move |sender| {
            sender.fill_cell(1, 1, b"x");
            sender.put(1, right);
        },
    );
    all([rule, expiring])
}

fn contents() -> Rows {
    let mut ids = Rule::new(BadId, "SM2-RNG-013");
    ids = put(ids, Subscriber, "id 0 in a cell", |sender| {
        sender.fill_cell(1, 0, b"x");
        sender.put(1, cell_word(1, 0, 1));
    });
    for id in [6, 7] {
        let what = format!("publication {id} in a cell, after 7 in a cell");
        ids = put(ids, Subscriber, what, move |sender| {
            for (sequence, id) in [(1, 7), (2, id)] {
                sender.fill_cell(sequence, id, b"x");
                sender.put(sequence, cell_word(1, 0, sequence));
            }
        });
        let what = format!("publication {id} in a cell, after 7 in a slot");
        ids = put(ids, BestEffort, what, move |sender| {
            sender.fill(0, b"x", head(7, 1));
            sender.put(1, word(1, 0, 1));
            sender.fill_cell(2, id, b"x");
            sender.put(2, cell_word(1, 0, 2));
        });
    }
    let mut status = Rule::new(ReservedNotZero, "SM2-RNG-013");
    for real in [Subscriber, BestEffort] {
        for number in [1, 2] {
            let what = format!("status {number} in a cell ({real:?})");
            status = put(status, real, what, move |sender| {
                sender.fill_cell(1, 1, b"x");
                sender.put(1, cell_word(1, number, 1));
            });
        }
    }
    all([ids, status])
}

/// Makes a message in a cell the first reply.
fn replied(rule: Rule, what: &str, id: u64, bits: u64) -> Rule {
    rule.fresh(Client, what, move |stage| {
        let (_receiver, sender) = stage.called_by_ring();
        sender.fill_cell(1, id, b"x");
        sender.put(1, bits);
        let heard = stage.victim.borrow_mut().ask("reply x");
        assert!(heard.contains("server"), "{heard}");
    })
}

fn replies() -> Rows {
    let unknown = Rule::new(UnknownCall, "SM2-SRV-002");
    let what = "a reply to no call in a cell";
    let unknown = replied(unknown, what, 2, cell_word(1, 0, 1));
    let length = Rule::new(BadLength, "SM2-SRV-002");
    let what = "status 2 with a payload in a cell";
    let length = replied(length, what, 1, cell_word(1, 2, 1));
    let status = Rule::new(BadWord, "SM2-RNG-007");
    let what = "status 4 of a reply in a cell";
    let status = replied(status, what, 1, cell_word(1, 4, 1));
    all([unknown, length, status])
}

/// Makes the publisher publish `count` messages in cells.
fn publish(stage: &LinkStage, count: u64) {
    let command = format!("publish x {count} 8");
    stage.victim.borrow_mut().tell(&command);
}

/// Makes the publisher publish a message in a cell, and takes it at the raw end. Returns its word.
fn taken(stage: &LinkStage) -> (RawReceiver, u64) {
    let receiver = stage.receiver();
    publish(stage, 1);
    let bits = receiver.take(1).expect("a message");
    assert_eq!(receiver.in_cell(bits).0, 1, "its id");
    (receiver, bits)
}

/// Wrong words that the sender finds in front of the cells that it is about to write.
fn swapped() -> Rows {
    let mut rule = Rule::new(BadWord, "SM2-RNG-005");
    for (what, bits) in [
        ("1", 1),
        ("a word of a slot", word(0, 0, 9)),
        ("a word of a cell", cell_word(8, 0, 9)),
    ] {
        let what = format!("{what} in front of an empty cell");
        rule = rule.fresh(Publisher, what, move |stage| {
            let receiver = stage.receiver();
            receiver.ring.swap(At::Forward(1), bits);
            publish(stage, 1);
        });
    }
    let what = "another message's word in front of a cell";
    rule = rule.fresh(Publisher, what, |stage| {
        let receiver = stage.receiver();
        publish(stage, 4);
        let other = receiver.ring.load(At::Forward(2));
        receiver.ring.swap(At::Forward(1), other);
        publish(stage, 1);
    });
    let what = "a message in a cell that counts as delivered, put back";
    all([rule.fresh(Publisher, what, |stage| {
        let (receiver, bits) = taken(stage);
        stage.victim.borrow_mut().tell("counters x");
        receiver.ring.swap(At::Forward(1), bits);
        publish(stage, 4);
    })])
}

/// A message in a cell is not given back.
fn given_back() -> Rows {
    let mut rule = Rule::new(BadWord, "SM2-RNG-008");
    for real in [Publisher, ReliablePublisher] {
        let what = format!("a message in a cell given back ({real:?})");
        rule = rule.fresh(real, what, |stage| {
            let (receiver, bits) = taken(stage);
            receiver.give(0, bits);
            stage.victim.borrow_mut().tell("counters x");
        });
    }
    all([rule])
}
