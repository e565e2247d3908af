//! Shared memory that no receiver may map, and slots that no message may name.

use std::{
    fs::File,
    os::fd::{AsFd, OwnedFd},
};

use nix::{
    fcntl::{OFlag, open},
    sys::{
        epoll::{Epoll, EpollCreateFlags},
        eventfd::EventFd,
        stat::Mode,
    },
};
use sm2_io::SeqPacket;
use sm2_proto::{
    Seals,
    ViolationKind::{
        BadLength, BadSegment, BadSegmentId, BadSize, BadSlot, MessageTooLong, NotAMemfd,
        NotSealed, SealsMissing, SegmentBusy, SegmentLimit, SlotBusy, UnknownSegment,
    },
};

use super::stage::{
    LinkStage,
    Real::{BestEffort, SealedSubscriber, Server, Subscriber},
    Rows, Rule, all,
};
use crate::{
    link::{Head, attach, detach, form, inline, kind, pooled, sealed},
    memory,
};

const PAGE: u64 = 4096;

pub(super) fn rows() -> Rows {
    let mut rows = kinds();
    rows.extend(seals_of_messages());
    rows.extend(seals_of_segments());
    rows.extend(sizes());
    rows.extend(geometries());
    rows.extend(segments());
    rows.extend(slots());
    rows.extend(lengths());
    rows
}

impl LinkStage {
    /// Opens, and attaches segment 1 with this many slots of a page.
    fn attached(&self, slots: u32) {
        self.open();
        let file = memory::segment(PAGE * u64::from(slots));
        self.send_fd(attach(1, PAGE, slots), &file);
    }
}

/// Every kind of descriptor that is not a memory file.
fn kinds() -> Rows {
    type Make = (&'static str, fn() -> OwnedFd);
    let kinds: [Make; 10] = [
        ("/dev/null", memory::null),
        ("/dev/zero", || file("/dev/zero")),
        ("a folder", || file("/")),
        ("a file of another file system", || {
            file("/proc/self/status")
        }),
        ("a file of huge pages", memory::huge),
        ("a pipe", || std::io::pipe().expect("a pipe").0.into()),
        ("a socket", || SeqPacket::pair().expect("sockets").0.into()),
        ("an eventfd", || {
            let eventfd = EventFd::new().expect("an eventfd");
            let copy = eventfd.as_fd().try_clone_to_owned();
            copy.expect("a copy")
        }),
        ("an epoll set", || {
            Epoll::new(EpollCreateFlags::EPOLL_CLOEXEC)
                .expect("a set")
                .0
        }),
        ("a path only", || {
            let flags = OFlag::O_PATH | OFlag::O_CLOEXEC;
            open("/dev/null", flags, Mode::empty()).expect("a path")
        }),
    ];
    let mut rule = Rule::new(NotAMemfd, "SM2-SEG-001");
    for (what, make) in kinds {
        rule = rule
            .open(
                Subscriber,
                format!("{what} for a sealed payload"),
                move |stage| {
                    stage.send_fd(sealed(kind::DATA, 1, 0), &make());
                },
            )
            .open(Subscriber, format!("{what} for a segment"), move |stage| {
                stage.send_fd(attach(1, PAGE, 1), &make());
            });
    }
    let what = "a file that is open for writing alone";
    all([rule
        .open(
            SealedSubscriber,
            format!("{what} for a sealed payload"),
            |stage| {
                let file = memory::write_only(&memory::sealed(PAGE));
                stage.send_fd(sealed(kind::DATA, 1, 1), &file);
            },
        )
        .open(Subscriber, format!("{what} for a segment"), |stage| {
            let file = memory::write_only(&memory::segment(PAGE));
            stage.send_fd(attach(1, PAGE, 1), &file);
        })])
}

fn file(path: &str) -> OwnedFd {
    File::open(path).expect("something to open").into()
}

const COMMON: [(&str, Seals); 3] = [
    ("SEAL", Seals::SEAL),
    ("SHRINK", Seals::SHRINK),
    ("GROW", Seals::GROW),
];

/// Each seal missing alone, all seals missing, and a seal that is similar to the required one.
fn seals_of_messages() -> Rows {
    let mut rule = Rule::new(SealsMissing, "SM2-SEG-001");
    let others = [("WRITE", Seals::WRITE), ("all", Seals::SEALED)];
    for (name, missing) in COMMON.into_iter().chain(others) {
        for real in [Subscriber, SealedSubscriber] {
            let what = format!("a payload without {name} ({real:?})");
            rule = rule.open(real, what, move |stage| {
                let file = memory::memfd(PAGE, memory::without(Seals::SEALED, missing));
                stage.send_fd(sealed(kind::DATA, 1, 1), &file);
            });
        }
    }
    let what = "a payload with FUTURE_WRITE instead of WRITE";
    let rule = rule
        .open(SealedSubscriber, what, |stage| {
            stage.send_fd(sealed(kind::DATA, 1, 1), &memory::segment(PAGE));
        })
        .open(Subscriber, "a file in /dev/shm", |stage| {
            let file = tempfile::tempfile_in("/dev/shm").expect("a file");
            stage.send_fd(sealed(kind::DATA, 1, 0), &file.into());
        });
    all([rule])
}

fn seals_of_segments() -> Rows {
    let mut rule = Rule::new(SealsMissing, "SM2-SEG-001");
    let others = [
        ("FUTURE_WRITE", Seals::FUTURE_WRITE),
        ("all", Seals::POOLED),
    ];
    for (name, missing) in COMMON.into_iter().chain(others) {
        let what = format!("a segment without {name}");
        rule = rule.open(Subscriber, what, move |stage| {
            let file = memory::memfd(PAGE, memory::without(Seals::POOLED, missing));
            stage.send_fd(attach(1, PAGE, 1), &file);
        });
    }
    let what = "a segment with WRITE instead of FUTURE_WRITE";
    all([rule.open(Subscriber, what, |stage| {
        stage.send_fd(attach(1, PAGE, 1), &memory::sealed(PAGE));
    })])
}

fn sizes() -> Rows {
    let mut of_messages = Rule::new(BadSize, "SM2-SEG-002");
    for (file, len) in [
        (0, 1),
        (PAGE, PAGE + 1),
        (PAGE, 1 << 30),
        ((1 << 41) + PAGE, 1),
    ] {
        let what = format!("a file of {file} bytes for {len}");
        of_messages = of_messages.open(SealedSubscriber, what, move |stage| {
            stage.send_fd(sealed(kind::DATA, 1, len), &memory::sealed(file));
        });
    }
    let mut of_segments = Rule::new(BadSize, "SM2-SEG-003");
    for file in [0, PAGE, 3 * PAGE, 2 * PAGE + 1, 2 * PAGE - 1] {
        let what = format!("a file of {file} bytes for two pages");
        of_segments = of_segments.open(Subscriber, what, move |stage| {
            stage.send_fd(attach(1, PAGE, 2), &memory::segment(file));
        });
    }
    all([of_messages, of_segments])
}

fn geometries() -> Rows {
    let geometries = [
        ("stride 0", 0, 1),
        ("stride 1", 1, 4096),
        ("stride 96", 96, 1),
        ("stride 4,097", 4097, 1),
        ("no slot", PAGE, 0),
        ("65,537 slots", PAGE, 65_537),
        ("2^41 bytes and a page", (1 << 41) + PAGE, 1),
        ("2^64 bytes", 1 << 60, 16),
    ];
    let mut rule = Rule::new(BadSegment, "SM2-SEG-003");
    for (what, stride, slots) in geometries {
        rule = rule.open(Subscriber, format!("ATTACH with {what}"), move |stage| {
            stage.send_fd(attach(1, stride, slots), &memory::segment(PAGE));
        });
    }
    all([rule])
}

fn segments() -> Rows {
    let number = Rule::new(BadSegmentId, "SM2-SEG-003").fresh(
        Subscriber,
        "ATTACH of a number in use",
        |stage| {
            stage.attached(1);
            stage.send_fd(attach(1, PAGE, 1), &memory::segment(PAGE));
        },
    );
    let limit = Rule::new(SegmentLimit, "SM2-SEG-004").open(Subscriber, "257 segments", |stage| {
        let file = memory::segment(PAGE);
        (0..257).for_each(|segment| stage.send_fd(attach(segment, PAGE, 1), &file));
    });
    let unknown = Rule::new(UnknownSegment, "SM2-SEG-005")
        .sent(Subscriber, "DETACH of no segment", detach(1))
        .fresh(Server, "DETACH twice", |stage| {
            stage.attached(1);
            stage.send(detach(1));
            stage.send(detach(1));
        });
    let busy = Rule::new(SegmentBusy, "SM2-SEG-005").fresh(
        Subscriber,
        "DETACH with an unreleased message",
        |stage| {
            stage.attached(1);
            stage.send(pooled(kind::DATA, 1, 1, 0, 1));
            stage.send(detach(1));
        },
    );
    all([number, limit, unknown, busy])
}

fn slots() -> Rows {
    let unknown = Rule::new(UnknownSegment, "SM2-PAY-003")
        .sent(
            Subscriber,
            "a slot of no segment",
            pooled(kind::DATA, 1, 1, 0, 1),
        )
        .fresh(
            Subscriber,
            "a slot of a segment that is detached",
            |stage| {
                stage.attached(1);
                stage.send(detach(1));
                stage.send(pooled(kind::DATA, 1, 1, 0, 1));
            },
        );
    let mut bad = Rule::new(BadSlot, "SM2-PAY-003");
    for slot in [2, u32::MAX] {
        bad = bad.fresh(Subscriber, format!("slot {slot} of two"), move |stage| {
            stage.attached(2);
            stage.send(pooled(kind::DATA, 1, 1, slot, 1));
        });
    }
    let busy = Rule::new(SlotBusy, "SM2-PAY-005")
        .fresh(Subscriber, "a slot twice", |stage| {
            stage.attached(2);
            stage.send(pooled(kind::DATA, 1, 1, 1, 1));
            stage.send(pooled(kind::DATA, 2, 1, 1, 1));
        })
        .fresh(Subscriber, "a slot that the application holds", |stage| {
            stage.attached(2);
            stage.send(pooled(kind::DATA, 1, 1, 0, 1));
            stage.victim.borrow_mut().tell("hold x 1");
            stage.send(pooled(kind::DATA, 2, 1, 0, 1));
        });
    let sealed = Rule::new(NotSealed, "SM2-PAY-001")
        .sent(
            SealedSubscriber,
            "a slot on a sealed link",
            pooled(kind::DATA, 1, 1, 0, 1),
        )
        .fresh(SealedSubscriber, "a segment on a sealed link", |stage| {
            stage.attached(1);
        });
    all([unknown, bad, busy, sealed])
}

fn lengths() -> Rows {
    let mut of_slots = Rule::new(BadLength, "SM2-PAY-003");
    for len in [PAGE + 1, u64::MAX] {
        let what = format!("{len} bytes in a slot of a page");
        of_slots = of_slots.fresh(Subscriber, what, move |stage| {
            stage.attached(1);
            stage.send(pooled(kind::DATA, 1, 1, 0, len));
        });
    }
    let mut of_messages = Rule::new(BadLength, "SM2-PAY-008");
    for len in [(1 << 40) + 1, u64::MAX] {
        let what = format!("a sealed message of {len} bytes");
        of_messages = of_messages.open(Subscriber, what, move |stage| {
            let head = Head {
                form: form::SEALED,
                len,
                ..Head::nth(kind::DATA, 1)
            };
            stage.send_fd(head.bytes(), &memory::sealed(PAGE));
        });
    }
    let mut too_long = Rule::new(MessageTooLong, "SM2-PAY-010");
    for (real, len) in [(Subscriber, (1 << 30) + 1), (BestEffort, 1_025)] {
        let what = format!("a sealed message of {len} bytes for {real:?}");
        too_long = too_long.open(real, what, move |stage| {
            let head = Head {
                form: form::SEALED,
                len,
                ..Head::nth(kind::DATA, 1)
            };
            stage.send_fd(head.bytes(), &memory::sealed(PAGE));
        });
    }
    too_long = too_long
        .fresh(BestEffort, "1,025 bytes in a slot of a page", |stage| {
            stage.attached(1);
            stage.send(pooled(kind::DATA, 1, 1, 0, 1_025));
        })
        .sent(
            BestEffort,
            "1,025 inline bytes",
            inline(kind::DATA, 1, &[0; 1_025]),
        );
    all([of_slots, of_messages, too_long])
}
