//! Messages out of order, beyond the window, released wrongly; calls that are none.

use sm2_proto::Violation;

use super::{LinkStage, Real, Rows, WINDOW, row};
use crate::link::{Head, cancel, inline, kind, release};

pub(super) fn rows() -> Rows {
    let mut rows = order();
    rows.extend(windows());
    rows.extend(releases());
    rows.extend(replies());
    rows.extend(cancels());
    rows
}

fn order() -> Rows {
    use Violation::{BadId, BadSequence};
    let mut rows = Rows::new();
    let ends = [
        (Real::Subscriber, kind::DATA, "SM2-MSG-002"),
        (Real::Server, kind::REQUEST, "SM2-SRV-002"),
    ];
    for (real, kind, clause) in ends {
        for sequence in [0, 2, u64::MAX] {
            let what = format!("{real:?}: the first message has number {sequence}");
            rows.push(row(real, BadSequence, "SM2-MSG-001", what, move |stage| {
                stage.open();
                stage.send(
                    Head {
                        sequence,
                        ..Head::nth(kind, 1)
                    }
                    .bytes(),
                );
            }));
        }
        for sequence in [1, 3] {
            let what = format!("{real:?}: the second message has number {sequence}");
            rows.push(row(real, BadSequence, "SM2-MSG-001", what, move |stage| {
                stage.messages(1);
                stage.send(
                    Head {
                        sequence,
                        ..Head::nth(kind, 2)
                    }
                    .bytes(),
                );
            }));
        }
        for id in [0, 6, 7] {
            let what = format!("{real:?}: id {id} after 7");
            rows.push(row(real, BadId, clause, what, move |stage| {
                stage.open();
                stage.send(
                    Head {
                        id: 7,
                        ..Head::nth(kind, 1)
                    }
                    .bytes(),
                );
                stage.send(
                    Head {
                        id,
                        ..Head::nth(kind, 2)
                    }
                    .bytes(),
                );
            }));
        }
    }
    let what = "Client: the first reply has number 2";
    rows.push(row(
        Real::Client,
        BadSequence,
        "SM2-MSG-001",
        what,
        |stage| {
            let id = stage.called();
            stage.send(
                Head {
                    id,
                    ..Head::nth(kind::REPLY, 2)
                }
                .bytes(),
            );
        },
    ));
    rows
}

fn windows() -> Rows {
    use Violation::{CallLimit, WindowExceeded};
    let mut rows = Rows::new();
    for real in [Real::Subscriber, Real::SealedSubscriber, Real::Server] {
        let what = format!("{real:?}: one message more than the window");
        rows.push(row(real, WindowExceeded, "SM2-MSG-003", what, |stage| {
            stage.messages(WINDOW + 1);
        }));
    }
    let what = "one message more while the application holds some";
    rows.push(row(
        Real::Subscriber,
        WindowExceeded,
        "SM2-MSG-003",
        what,
        |stage| {
            stage.messages(WINDOW);
            stage.victim.borrow_mut().tell("hold x 2");
            stage.send(inline(kind::DATA, WINDOW + 1, b"x"));
        },
    ));
    let what = "1,025 calls without a reply";
    rows.push(row(
        Real::WideServer,
        CallLimit,
        "SM2-SRV-002",
        what,
        |stage| {
            stage.messages(1025);
        },
    ));
    rows
}

fn releases() -> Rows {
    let violation = Violation::BadRelease;
    let mut rows = Rows::new();
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
    for (what, sequences) in lists {
        let what = format!("RELEASE of {what}");
        rows.push(row(
            Real::Publisher,
            violation,
            "SM2-MSG-004",
            what,
            move |stage| {
                stage.published(3);
                stage.send(release(0, &sequences));
            },
        ));
    }
    for fates in [[0, 0], [0, 1], [1, 0]] {
        let what = format!("RELEASE of the same message again, fates {fates:?}");
        rows.push(row(
            Real::Publisher,
            violation,
            "SM2-MSG-004",
            what,
            move |stage| {
                stage.published(3);
                fates
                    .iter()
                    .for_each(|&fate| stage.send(release(fate, &[2])));
            },
        ));
    }
    let what = "RELEASE of a request that was never sent";
    rows.push(row(
        Real::Client,
        violation,
        "SM2-MSG-004",
        what,
        |stage: &LinkStage| {
            stage.called();
            stage.send(release(0, &[2]));
        },
    ));
    let what = "RELEASE of a reply that was never sent";
    rows.push(row(Real::Server, violation, "SM2-MSG-004", what, |stage| {
        stage.messages(1);
        stage.send(release(0, &[1]));
    }));
    rows
}

fn replies() -> Rows {
    use Violation::{BadLength, UnknownCall};
    let mut rows = Rows::new();
    let what = "REPLY without a call";
    rows.push(row(
        Real::Client,
        UnknownCall,
        "SM2-SRV-003",
        what,
        |stage| {
            stage.open();
            stage.send(inline(kind::REPLY, 1, b"x"));
        },
    ));
    let what = "REPLY for another call";
    rows.push(row(
        Real::Client,
        UnknownCall,
        "SM2-SRV-003",
        what,
        |stage| {
            let id = stage.called() + 1;
            stage.send(
                Head {
                    id,
                    ..Head::nth(kind::REPLY, 1)
                }
                .bytes(),
            );
        },
    ));
    let what = "REPLY twice";
    rows.push(row(
        Real::Client,
        UnknownCall,
        "SM2-SRV-003",
        what,
        |stage| {
            let id = stage.called();
            for n in 1..=2 {
                stage.send(
                    Head {
                        id,
                        ..Head::nth(kind::REPLY, n)
                    }
                    .bytes(),
                );
            }
        },
    ));
    for status in [2, 3] {
        let what = format!("REPLY with status {status} and a payload");
        rows.push(row(
            Real::Client,
            BadLength,
            "SM2-SRV-003",
            what,
            move |stage| {
                let id = stage.called();
                let head = Head::nth(kind::REPLY, 1);
                stage.send(
                    Head {
                        id,
                        status,
                        len: 1,
                        ..head
                    }
                    .with(b"x"),
                );
            },
        ));
    }
    rows
}

fn cancels() -> Rows {
    use Violation::{BadCancel, UnknownCall};
    let mut rows = Rows::new();
    for call in [0, 2, u64::MAX] {
        let what = format!("CANCEL of call {call}, which was never made");
        rows.push(row(
            Real::Server,
            UnknownCall,
            "SM2-SRV-004",
            what,
            move |stage| {
                stage.messages(1);
                stage.send(cancel(call));
            },
        ));
    }
    let what = "CANCEL twice";
    rows.push(row(Real::Server, BadCancel, "SM2-SRV-004", what, |stage| {
        stage.messages(1);
        stage.send(cancel(1));
        stage.send(cancel(1));
    }));
    rows
}
