//! Links whose ends both offer the ring lane, up to the exchange of the shared file.

use std::os::fd::AsFd;

use sm2_proto::{
    Seals,
    ViolationKind::{
        BadLength, BadRing, FdCount, NotAMemfd, ReservedNotZero, SealsMissing, UnknownSegment,
        WrongLane, WrongRole,
    },
};

use super::stage::{
    LinkStage,
    Real::{BestEffort, Client, Publisher, SealedSubscriber, Server, Subscriber},
    Rows, Rule, all,
};
use crate::{
    link::{detach, detached, doorbell, inline, kind, release, ring, with_byte},
    memory,
    ring::{RawReceiver, RawSender, size},
};

/// The ring that raw receivers make: window 6, as in their OPEN.
pub(super) const DEPTH: u16 = 4;
pub(super) const WINDOW: u32 = 6;

pub(super) fn rows() -> Rows {
    let mut rows = lanes();
    rows.extend(roles());
    rows.extend(layouts());
    rows.extend(files());
    rows.extend(offers());
    rows
}

impl LinkStage {
    /// Both sides send OPEN and offer the ring lane.
    pub(super) fn agree(&self) {
        self.send(self.greeting().with_ring().bytes());
        self.expect_open();
    }

    /// Opens, maps the real end's ring, and attaches segment 1.
    pub(super) fn sender(&self, slots: u32) -> RawSender {
        self.agree();
        RawSender::new(&self.link, slots)
    }

    /// Opens with a ring of the raw end.
    pub(super) fn receiver(&self) -> RawReceiver {
        self.agree();
        let receiver = RawReceiver::new(DEPTH, WINDOW);
        receiver.offer(&self.link);
        self.victim.borrow_mut().tell("wait x 1");
        receiver
    }

    /// RING with this file.
    fn offer(&self, depth: u16, window: u32, seals: Seals, size: u64) {
        self.agree();
        self.send_fd(ring(depth, window), &memory::memfd(size, seals));
    }
}

fn lanes() -> Rows {
    let with_ring = Rule::new(WrongLane, "SM2-RNG-001")
        .fresh(Subscriber, "DATA on the ring lane", |stage| {
            let _sender = stage.sender(1);
            stage.send(inline(kind::DATA, 1, b"x"));
        })
        .fresh(Publisher, "RELEASE on the ring lane", |stage| {
            let _receiver = stage.receiver();
            stage.send(release(0, &[1]));
        })
        .fresh(Publisher, "RELEASE before RING", |stage| {
            stage.agree();
            stage.send(release(0, &[1]));
        });
    let without = with_ring
        .open(Publisher, "RING on the socket lane", |stage| {
            RawReceiver::new(DEPTH, WINDOW).offer(&stage.link);
        })
        .sent(Publisher, "DETACHED on the socket lane", detached(1));
    let reals = [
        Subscriber,
        SealedSubscriber,
        BestEffort,
        Publisher,
        Server,
        Client,
    ];
    all([reals.into_iter().fold(without, |rule, real| {
        let what = format!("DOORBELL on the socket lane to a {real:?}");
        rule.sent(real, what, doorbell())
    })])
}

fn roles() -> Rows {
    let rule = Rule::new(WrongRole, "SM2-WIR-002")
        .fresh(Subscriber, "RING of a publisher", |stage| {
            let _sender = stage.sender(1);
            RawReceiver::new(DEPTH, WINDOW).offer(&stage.link);
        })
        .fresh(Subscriber, "DETACHED of a publisher", |stage| {
            let _sender = stage.sender(1);
            stage.send(detached(1));
        })
        .fresh(Publisher, "DETACH of a subscriber", |stage| {
            let _receiver = stage.receiver();
            stage.send(detach(1));
        });
    all([rule])
}

fn layouts() -> Rows {
    let offer = |stage: &LinkStage, bytes: Vec<u8>, fds: usize| {
        stage.agree();
        let file = memory::memfd(size(DEPTH, WINDOW), Seals::RING);
        stage.link.end.send_fds(bytes, &vec![file.as_fd(); fds]);
    };
    let longer = || [ring(DEPTH, WINDOW), vec![0]].concat();
    let mut reserved = Rule::new(ReservedNotZero, "SM2-WIR-001");
    for offset in [1, 8, 15] {
        reserved = reserved.fresh(Publisher, format!("RING, byte {offset}"), move |stage| {
            offer(stage, with_byte(ring(DEPTH, WINDOW), offset, 1), 1);
        });
    }
    let frames = [
        ("DOORBELL", 1, doorbell()),
        ("DOORBELL", 7, doorbell()),
        ("DETACHED", 3, detached(1)),
    ];
    for (what, offset, bytes) in frames {
        reserved = reserved.fresh(Publisher, format!("{what}, byte {offset}"), move |stage| {
            let _receiver = stage.receiver();
            stage.send(with_byte(bytes.clone(), offset, 1));
        });
    }
    let length = Rule::new(BadLength, "SM2-WIR-001")
        .fresh(Publisher, "RING of 17 bytes", move |stage| {
            offer(stage, longer(), 1)
        })
        .fresh(Publisher, "RING of 8 bytes", move |stage| {
            offer(stage, longer()[..8].to_vec(), 1);
        })
        .fresh(Subscriber, "DOORBELL of 1 byte", |stage| {
            let _sender = stage.sender(1);
            stage.send([kind::DOORBELL]);
        });
    let count = Rule::new(FdCount, "SM2-TRN-010")
        .fresh(Publisher, "RING without a descriptor", move |stage| {
            offer(stage, ring(DEPTH, WINDOW), 0);
        })
        .fresh(Publisher, "RING with two", move |stage| {
            offer(stage, ring(DEPTH, WINDOW), 2);
        });
    all([reserved, length, count])
}

/// Files that are illegal for a ring.
fn files() -> Rows {
    let kinds = Rule::new(NotAMemfd, "SM2-RNG-002")
        .fresh(Publisher, "/dev/null for a ring", |stage| {
            stage.agree();
            stage.send_fd(ring(DEPTH, WINDOW), &memory::null());
        })
        .fresh(Publisher, "a pipe for a ring", |stage| {
            stage.agree();
            let pipe = std::io::pipe().expect("a pipe").0.into();
            stage.send_fd(ring(DEPTH, WINDOW), &pipe);
        })
        .fresh(
            Publisher,
            "a ring that is open for reading alone",
            |stage| {
                stage.agree();
                let file = memory::memfd(size(DEPTH, WINDOW), Seals::RING);
                stage.send_fd(ring(DEPTH, WINDOW), &memory::reopened(&file));
            },
        );
    let mut missing = Rule::new(SealsMissing, "SM2-RNG-002");
    let seals = [
        ("SEAL", Seals::SEAL),
        ("SHRINK", Seals::SHRINK),
        ("GROW", Seals::GROW),
        ("all", Seals::RING),
    ];
    for (name, without) in seals {
        missing = missing.fresh(Publisher, format!("a ring without {name}"), move |stage| {
            let seals = memory::without(Seals::RING, without);
            stage.offer(DEPTH, WINDOW, seals, size(DEPTH, WINDOW));
        });
    }
    let mut bad = Rule::new(BadRing, "SM2-RNG-002");
    for (name, seals) in [("WRITE", Seals::SEALED), ("FUTURE_WRITE", Seals::POOLED)] {
        bad = bad.fresh(Publisher, format!("a ring with {name}"), move |stage| {
            stage.offer(DEPTH, WINDOW, seals, size(DEPTH, WINDOW));
        });
    }
    for size in [0, 4095, 4097, 8192, 1 << 41] {
        bad = bad.fresh(Publisher, format!("a ring of {size} bytes"), move |stage| {
            stage.offer(DEPTH, WINDOW, Seals::RING, size);
        });
    }
    all([kinds, missing, bad])
}

fn offers() -> Rows {
    let mut bad = Rule::new(BadRing, "SM2-RNG-002");
    let offers = [
        ("depth 0", 0, WINDOW),
        ("depth 1,025", 1025, 2048),
        ("depth 2^16 - 1", u16::MAX, WINDOW),
        ("a depth that is the window", 6, WINDOW),
        ("a window less than in OPEN", DEPTH, 5),
        ("a window greater than in OPEN", DEPTH, 7),
        ("window 0", DEPTH, 0),
        ("window 2,049", DEPTH, 2049),
        ("window 2^32 - 1", DEPTH, u32::MAX),
    ];
    for (what, depth, window) in offers {
        bad = bad.fresh(Publisher, format!("RING with {what}"), move |stage| {
            stage.offer(depth, window, Seals::RING, size(depth, window.min(1 << 20)));
        });
    }
    let bad = bad.fresh(Publisher, "RING twice", |stage| {
        stage.receiver().offer(&stage.link);
    });
    let detached = Rule::new(UnknownSegment, "SM2-RNG-009")
        .fresh(Publisher, "DETACHED without DETACH", |stage| {
            let _receiver = stage.receiver();
            stage.send(detached(0));
        })
        .fresh(Publisher, "DETACHED of an attached segment", |stage| {
            let _receiver = stage.receiver();
            stage.victim.borrow_mut().tell("publish x 1 200");
            assert_eq!(stage.link.end.expect().bytes[0], kind::ATTACH);
            stage.send(detached(0));
        })
        .fresh(Publisher, "DETACHED before RING", |stage| {
            stage.agree();
            stage.send(detached(0));
        });
    all([bad, detached])
}
