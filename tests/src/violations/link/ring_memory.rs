//! Words in a ring, and heads in slots, that no honest end would write.

use sm2_proto::{
    ViolationKind::{
        BadId, BadLength, BadSegment, BadSlot, BadWord, MessageTooLong, ReservedNotZero,
        SegmentBusy, SlotBusy, UnknownSegment, WindowExceeded,
    },
    link::{At, RingMemory},
};

use super::stage::{
    LinkStage,
    Real::{self, BestEffort, Publisher, ReliablePublisher, Subscriber},
    Rows, Rule, all,
};
use crate::{
    link::{attach, detach, kind},
    memory,
    ring::{PAGE, RawReceiver, RawSender, head, word},
};

pub(super) fn rows() -> Rows {
    let mut rows = forward_words();
    rows.extend(places());
    rows.extend(heads());
    rows.extend(displaced_words());
    rows.extend(back_words());
    rows.extend(windows());
    rows
}

impl LinkStage {
    /// Makes the subscriber take everything in the ring.
    pub(super) fn drain(&self) {
        self.victim.borrow_mut().tell("drain x");
    }

    /// Makes the publisher publish `count` messages that are too long for cells, and reads ATTACH.
    fn publishes(&self, count: u64) {
        let command = format!("publish x {count} 200");
        self.victim.borrow_mut().tell(&command);
        let frame = self.link.end.expect().bytes;
        assert_eq!(frame[0], kind::ATTACH, "{frame:?}");
    }

    /// Makes the publisher publish `count` messages, and takes them at the raw end. Returns their
    /// words.
    fn taken(&self, count: u64) -> (RawReceiver, Vec<u64>) {
        let receiver = self.receiver();
        self.publishes(count);
        let words = (1..=count).map(|n| receiver.take(n).expect("a message"));
        let words = words.collect();
        (receiver, words)
    }
}

/// A row on a ring with room for a message that the subscriber has not taken.
fn put(
    rule: Rule,
    real: Real,
    what: impl Into<String>,
    commit: impl Fn(&LinkStage, &mut RawSender) + 'static,
) -> Rule {
    rule.fresh(real, what, move |stage| {
        let mut sender = stage.sender(4);
        commit(stage, &mut sender);
        stage.drain();
    })
}

fn forward_words() -> Rows {
    let mut rule = Rule::new(BadWord, "SM2-RNG-007");
    for real in [Subscriber, BestEffort] {
        let words = [
            ("bit 31 alone missing", word(1, 0, 1) & !(1 << 31)),
            ("1", 1),
            ("sequence number 0", word(1, 0, 0)),
            ("sequence number 2", word(1, 0, 2)),
            ("one of the past", word(1, 0, u64::from(u32::MAX))),
        ];
        for (what, bits) in words {
            rule = put(
                rule,
                real,
                format!("{what} ({real:?})"),
                move |_, sender| {
                    sender.fill(0, b"x", head(1, 1));
                    sender.put(1, bits);
                },
            );
        }
        let what = format!("message 1 again instead of 5 ({real:?})");
        rule = put(rule, real, what, |stage, sender| {
            for n in 1..=4 {
                assert_eq!(sender.send(n, n as usize % 4, b"payload"), 0);
            }
            stage.drain();
            sender.put(5, word(1, 1, 1));
        });
    }
    let what = "a sender that goes round on a reliable link";
    all([put(rule, Subscriber, what, |_, sender| {
        sender.send(5, 0, b"x");
    })])
}

fn places() -> Rows {
    let mut unknown = Rule::new(UnknownSegment, "SM2-RNG-007");
    for segment in [0, 2, 0x7fff] {
        let what = format!("a message in segment {segment}");
        unknown = put(unknown, Subscriber, what, move |_, sender| {
            sender.put(1, word(segment, 0, 1));
        });
    }
    let mut outside = Rule::new(BadSlot, "SM2-RNG-007");
    for slot in [4, 0xffff] {
        let what = format!("slot {slot} of four");
        outside = put(outside, BestEffort, what, move |_, sender| {
            sender.put(1, word(1, slot, 1));
        });
    }
    let busy = put(
        Rule::new(SlotBusy, "SM2-RNG-007"),
        Subscriber,
        "a slot that the application holds",
        |stage, sender| {
            sender.send(1, 3, b"x");
            stage.victim.borrow_mut().tell("hold x 1");
            sender.send(2, 3, b"y");
        },
    );
    let detached = Rule::new(SegmentBusy, "SM2-SEG-005").fresh(
        Subscriber,
        "DETACH of a segment that the application reads",
        |stage| {
            stage.sender(1).send(1, 0, b"x");
            stage.victim.borrow_mut().tell("hold x 1");
            stage.send(detach(1));
        },
    );
    let gone = put(
        Rule::new(UnknownSegment, "SM2-RNG-007"),
        Subscriber,
        "a message in a segment that is detached",
        |stage, sender| {
            stage.send(detach(1));
            assert_eq!(stage.link.end.expect().bytes[0], kind::DETACHED);
            sender.send(1, 0, b"x");
        },
    );
    let beyond = put(
        Rule::new(BadSegment, "SM2-RNG-003"),
        Subscriber,
        "ATTACH of a number that no word can name",
        |stage, _| stage.send_fd(attach(32_768, PAGE, 1), &memory::segment(PAGE)),
    );
    all([unknown, outside, busy, detached, gone, beyond])
}

fn heads() -> Rows {
    let mut ids = Rule::new(BadId, "SM2-RNG-004");
    for id in [0, 6, 7] {
        let what = format!("publication {id} after 7");
        ids = put(ids, Subscriber, what, move |_, sender| {
            sender.fill(0, b"x", head(7, 1));
            sender.put(1, word(1, 0, 1));
            sender.fill(1, b"x", head(id, 1));
            sender.put(2, word(1, 1, 2));
        });
    }
    let mut lengths = Rule::new(BadLength, "SM2-RNG-004");
    for len in [PAGE - 63, PAGE, PAGE + 1, 1 << 41, u64::MAX] {
        let what = format!("{len} bytes in a slot of a page");
        lengths = put(lengths, BestEffort, what, move |_, sender| {
            sender.fill(0, b"x", head(1, len));
            sender.put(1, word(1, 0, 1));
        });
    }
    let too_long = put(
        Rule::new(MessageTooLong, "SM2-PAY-010"),
        BestEffort,
        "a head of 1,025 bytes",
        |_, sender| {
            sender.fill(0, b"x", head(1, 1_025));
            sender.put(1, word(1, 0, 1));
        },
    );
    let mut reserved = Rule::new(ReservedNotZero, "SM2-RNG-004");
    for byte in [24, 40, 63] {
        let what = format!("a head whose byte {byte} is not zero");
        reserved = put(reserved, Subscriber, what, move |_, sender| {
            let mut head = head(1, 1);
            head[byte] = 1;
            sender.fill(0, b"x", head);
            sender.put(1, word(1, 0, 1));
        });
    }
    all([ids, lengths, too_long, reserved])
}

/// Wrong words that the sender finds at the positions where it puts its own words.
fn displaced_words() -> Rows {
    let mut rule = Rule::new(BadWord, "SM2-RNG-005");
    for (what, bits) in [("1", 1), ("a word that was never there", word(0, 0, 9))] {
        rule = rule.fresh(
            Publisher,
            format!("{what} instead of nothing"),
            move |stage| {
                let receiver = stage.receiver();
                receiver.ring.swap(At::Forward(1), bits);
                stage.publishes(1);
            },
        );
    }
    rule = rule
        .fresh(Publisher, "another message's word", |stage| {
            let receiver = stage.receiver();
            stage.publishes(4);
            let other = receiver.ring.load(At::Forward(2));
            receiver.ring.swap(At::Forward(1), other);
            stage.victim.borrow_mut().tell("publish x 1 200");
        })
        .fresh(Publisher, "a message that was taken, put back", |stage| {
            let (receiver, words) = stage.taken(1);
            receiver.give(0, words[0]);
            stage.victim.borrow_mut().tell("publish x 3 200");
            receiver.ring.swap(At::Forward(1), words[0]);
            stage.victim.borrow_mut().tell("publish x 1 200");
        });
    all([rule])
}

/// Wrong words that the sender finds where the receiver gives messages back.
fn back_words() -> Rows {
    type Forge = (&'static str, fn(u64) -> u64);
    let forged: [Forge; 6] = [
        ("1 given back", |_| 1),
        ("a message that was never sent given back", |_| {
            word(0, 0, 99)
        }),
        ("a message of another slot given back", |bits| bits ^ 1),
        ("a message of another segment given back", |bits| {
            bits ^ 1 << 16
        }),
        ("a message of a segment that is none given back", |bits| {
            bits | 0x7fff << 16
        }),
        ("a slot that is none given back", |bits| bits | 0xffff),
    ];
    let mut rule = Rule::new(BadWord, "SM2-RNG-008");
    for real in [Publisher, ReliablePublisher] {
        for (what, forge) in forged {
            rule = rule.fresh(real, format!("{what} ({real:?})"), move |stage| {
                let (receiver, words) = stage.taken(1);
                receiver.give(0, forge(words[0]));
                stage.victim.borrow_mut().tell("counters x");
            });
        }
        rule = rule.fresh(real, format!("a message twice ({real:?})"), |stage| {
            let (receiver, words) = stage.taken(2);
            receiver.give(0, words[0]);
            receiver.give(1, words[0]);
            stage.victim.borrow_mut().tell("counters x");
        });
    }
    rule = rule.fresh(Publisher, "one that was not taken", |stage| {
        let receiver = stage.receiver();
        stage.publishes(1);
        receiver.give(0, receiver.ring.load(At::Forward(1)));
        // The sender finds the word at the latest when it reuses the index.
        stage.victim.borrow_mut().tell("publish x 4 200");
    });
    let what = "something where the receiver gives back";
    all([rule.fresh(Subscriber, what, |stage| {
        let mut sender = stage.sender(4);
        sender.ring.swap(At::Back(0), word(1, 0, 1));
        sender.send(1, 0, b"x");
        stage.drain();
    })])
}

fn windows() -> Rows {
    let rule = Rule::new(WindowExceeded, "SM2-RNG-006");
    let what = "a receiver that takes more than its window and gives nothing back";
    all([rule.fresh(Publisher, what, |stage| {
        let (receiver, _words) = stage.taken(4);
        for n in 5..=6 {
            stage.victim.borrow_mut().tell("publish x 1 200");
            let _word = receiver.take(n).expect("a message");
        }
        stage.victim.borrow_mut().tell("publish x 1 200");
    })])
}
