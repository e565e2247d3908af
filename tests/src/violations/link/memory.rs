//! Shared memory that no receiver may map, and slots that no message may name.

use std::{
    fs::File,
    os::fd::{AsFd, OwnedFd},
};

use nix::sys::{
    epoll::{Epoll, EpollCreateFlags},
    eventfd::EventFd,
};
use sm2_io::SeqPacket;
use sm2_proto::{Seals, Violation};

use super::{LinkStage, Real, Rows, row};
use crate::{
    link::{Head, attach, detach, form, kind, pooled, sealed},
    memory,
};

const PAGE: u64 = 4096;

pub(super) fn rows() -> Rows {
    let mut rows = kinds();
    rows.extend(seals());
    rows.extend(sizes());
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

/// Everything that can be open and is no memory file.
fn kinds() -> Rows {
    type Make = fn() -> OwnedFd;
    let kinds: [(&str, Make); 9] = [
        ("/dev/null", memory::null),
        ("/dev/zero", || {
            File::open("/dev/zero").expect("a device").into()
        }),
        ("a folder", || File::open("/").expect("a folder").into()),
        ("a file on a disk", || {
            tempfile::tempfile().expect("a file").into()
        }),
        ("a pipe", || std::io::pipe().expect("a pipe").0.into()),
        ("a socket", || SeqPacket::pair().expect("sockets").0.into()),
        ("an eventfd", || {
            EventFd::new()
                .expect("an eventfd")
                .as_fd()
                .try_clone_to_owned()
                .expect("a copy")
        }),
        ("an epoll set", || {
            let set = Epoll::new(EpollCreateFlags::EPOLL_CLOEXEC).expect("a set");
            set.0
        }),
        ("a path only", || {
            let flags = nix::fcntl::OFlag::O_PATH | nix::fcntl::OFlag::O_CLOEXEC;
            nix::fcntl::open("/dev/null", flags, nix::sys::stat::Mode::empty()).expect("a path")
        }),
    ];
    let mut rows = Rows::new();
    let violation = Violation::NotAMemfd;
    for (what, make) in kinds {
        let named = format!("{what} for a sealed payload");
        rows.push(row(
            Real::Subscriber,
            violation,
            "SM2-SEG-001",
            named,
            move |stage| {
                stage.open();
                stage.send_fd(sealed(kind::DATA, 1, 0), &make());
            },
        ));
        let named = format!("{what} for a segment");
        rows.push(row(
            Real::Subscriber,
            violation,
            "SM2-SEG-001",
            named,
            move |stage| {
                stage.open();
                stage.send_fd(attach(1, PAGE, 1), &make());
            },
        ));
    }
    rows
}

/// Every seal missing alone, all of them, and the one that looks like another.
fn seals() -> Rows {
    let violation = Violation::SealsMissing;
    let mut rows = Rows::new();
    let common = [
        ("SEAL", Seals::SEAL),
        ("SHRINK", Seals::SHRINK),
        ("GROW", Seals::GROW),
    ];
    let of_message = common
        .into_iter()
        .chain([("WRITE", Seals::WRITE), ("all", Seals::SEALED)]);
    for (name, missing) in of_message {
        for real in [Real::Subscriber, Real::SealedSubscriber] {
            let what = format!("a payload without {name} ({real:?})");
            rows.push(row(real, violation, "SM2-SEG-001", what, move |stage| {
                stage.open();
                let file = memory::memfd(PAGE, memory::without(Seals::SEALED, missing));
                stage.send_fd(sealed(kind::DATA, 1, 1), &file);
            }));
        }
    }
    let future = ("FUTURE_WRITE", Seals::FUTURE_WRITE);
    for (name, missing) in common.into_iter().chain([future, ("all", Seals::POOLED)]) {
        let what = format!("a segment without {name}");
        rows.push(row(
            Real::Subscriber,
            violation,
            "SM2-SEG-001",
            what,
            move |stage| {
                stage.open();
                let file = memory::memfd(PAGE, memory::without(Seals::POOLED, missing));
                stage.send_fd(attach(1, PAGE, 1), &file);
            },
        ));
    }
    let what = "a payload with FUTURE_WRITE instead of WRITE";
    rows.push(row(
        Real::SealedSubscriber,
        violation,
        "SM2-SEG-001",
        what,
        |stage| {
            stage.open();
            stage.send_fd(sealed(kind::DATA, 1, 1), &memory::segment(PAGE));
        },
    ));
    let what = "a segment with WRITE instead of FUTURE_WRITE";
    rows.push(row(
        Real::Subscriber,
        violation,
        "SM2-SEG-001",
        what,
        |stage| {
            stage.open();
            stage.send_fd(attach(1, PAGE, 1), &memory::sealed(PAGE));
        },
    ));
    let what = "a file in /dev/shm";
    rows.push(row(
        Real::Subscriber,
        violation,
        "SM2-SEG-001",
        what,
        |stage| {
            stage.open();
            let file: OwnedFd = tempfile::tempfile_in("/dev/shm").expect("a file").into();
            stage.send_fd(sealed(kind::DATA, 1, 0), &file);
        },
    ));
    rows
}

fn sizes() -> Rows {
    let violation = Violation::BadSize;
    let mut rows = Rows::new();
    for (file, len) in [
        (0, 1),
        (PAGE, PAGE + 1),
        (PAGE, 1 << 40),
        ((1 << 41) + PAGE, 1),
    ] {
        let what = format!("a file of {file} bytes for {len}");
        rows.push(row(
            Real::SealedSubscriber,
            violation,
            "SM2-SEG-002",
            what,
            move |stage| {
                stage.open();
                stage.send_fd(sealed(kind::DATA, 1, len), &memory::sealed(file));
            },
        ));
    }
    for file in [0, PAGE, 3 * PAGE, 2 * PAGE + 1, 2 * PAGE - 1] {
        let what = format!("a file of {file} bytes for two pages");
        rows.push(row(
            Real::Subscriber,
            violation,
            "SM2-SEG-003",
            what,
            move |stage| {
                stage.open();
                stage.send_fd(attach(1, PAGE, 2), &memory::segment(file));
            },
        ));
    }
    rows
}

fn segments() -> Rows {
    use Violation::{BadSegment, SegmentBusy, SegmentLimit, SegmentNumber, UnknownSegment};
    let mut rows = Rows::new();
    let geometries = [
        ("stride 0", 0, 1),
        ("stride 1", 1, 4096),
        ("stride 4,097", 4097, 1),
        ("no slot", PAGE, 0),
        ("65,537 slots", PAGE, 65_537),
        ("2^41 bytes and a page", (1 << 41) + PAGE, 1),
        ("2^64 bytes", 1 << 60, 16),
    ];
    for (what, stride, slots) in geometries {
        let what = format!("ATTACH with {what}");
        rows.push(row(
            Real::Subscriber,
            BadSegment,
            "SM2-SEG-003",
            what,
            move |stage| {
                stage.open();
                stage.send_fd(attach(1, stride, slots), &memory::segment(PAGE));
            },
        ));
    }
    let what = "ATTACH of a number in use";
    rows.push(row(
        Real::Subscriber,
        SegmentNumber,
        "SM2-SEG-003",
        what,
        |stage| {
            stage.attached(1);
            stage.send_fd(attach(1, PAGE, 1), &memory::segment(PAGE));
        },
    ));
    let what = "257 segments";
    rows.push(row(
        Real::Subscriber,
        SegmentLimit,
        "SM2-SEG-004",
        what,
        |stage| {
            stage.open();
            let file = memory::segment(PAGE);
            (0..257).for_each(|segment| stage.send_fd(attach(segment, PAGE, 1), &file));
        },
    ));
    let what = "DETACH of no segment";
    rows.push(row(
        Real::Subscriber,
        UnknownSegment,
        "SM2-SEG-005",
        what,
        |stage| {
            stage.open();
            stage.send(detach(1));
        },
    ));
    let what = "DETACH twice";
    rows.push(row(
        Real::Server,
        UnknownSegment,
        "SM2-SEG-005",
        what,
        |stage| {
            stage.attached(1);
            stage.send(detach(1));
            stage.send(detach(1));
        },
    ));
    let what = "DETACH with an unreleased message";
    rows.push(row(
        Real::Subscriber,
        SegmentBusy,
        "SM2-SEG-005",
        what,
        |stage| {
            stage.attached(1);
            stage.send(pooled(kind::DATA, 1, 1, 0, 1));
            stage.send(detach(1));
        },
    ));
    rows
}

fn slots() -> Rows {
    use Violation::{BadSlot, NotSealed, SlotBusy, UnknownSegment};
    let mut rows = Rows::new();
    let what = "a slot of no segment";
    rows.push(row(
        Real::Subscriber,
        UnknownSegment,
        "SM2-PAY-002",
        what,
        |stage| {
            stage.open();
            stage.send(pooled(kind::DATA, 1, 1, 0, 1));
        },
    ));
    let what = "a slot of a segment that is detached";
    rows.push(row(
        Real::Subscriber,
        UnknownSegment,
        "SM2-PAY-002",
        what,
        |stage| {
            stage.attached(1);
            stage.send(detach(1));
            stage.send(pooled(kind::DATA, 1, 1, 0, 1));
        },
    ));
    for slot in [2, u32::MAX] {
        let what = format!("slot {slot} of two");
        rows.push(row(
            Real::Subscriber,
            BadSlot,
            "SM2-PAY-002",
            what,
            move |stage| {
                stage.attached(2);
                stage.send(pooled(kind::DATA, 1, 1, slot, 1));
            },
        ));
    }
    let what = "a slot twice";
    rows.push(row(
        Real::Subscriber,
        SlotBusy,
        "SM2-PAY-005",
        what,
        |stage| {
            stage.attached(2);
            stage.send(pooled(kind::DATA, 1, 1, 1, 1));
            stage.send(pooled(kind::DATA, 2, 1, 1, 1));
        },
    ));
    let what = "a slot of a message that the application holds";
    rows.push(row(
        Real::Subscriber,
        SlotBusy,
        "SM2-PAY-005",
        what,
        |stage| {
            stage.attached(2);
            stage.send(pooled(kind::DATA, 1, 1, 0, 1));
            stage.victim.borrow_mut().tell("hold x 1");
            stage.send(pooled(kind::DATA, 2, 1, 0, 1));
        },
    ));
    let what = "a slot on a sealed link";
    rows.push(row(
        Real::SealedSubscriber,
        NotSealed,
        "SM2-PAY-004",
        what,
        |stage| {
            stage.attached(1);
            stage.send(pooled(kind::DATA, 1, 1, 0, 1));
        },
    ));
    rows
}

fn lengths() -> Rows {
    let violation = Violation::BadLength;
    let mut rows = Rows::new();
    for len in [PAGE + 1, u64::MAX] {
        let what = format!("{len} bytes in a slot of a page");
        rows.push(row(
            Real::Subscriber,
            violation,
            "SM2-PAY-002",
            what,
            move |stage| {
                stage.attached(1);
                stage.send(pooled(kind::DATA, 1, 1, 0, len));
            },
        ));
    }
    for len in [(1 << 40) + 1, u64::MAX] {
        let what = format!("a sealed message of {len} bytes");
        rows.push(row(
            Real::Subscriber,
            violation,
            "SM2-PAY-008",
            what,
            move |stage| {
                stage.open();
                let head = Head {
                    form: form::SEALED,
                    len,
                    ..Head::nth(kind::DATA, 1)
                };
                stage.send_fd(head.bytes(), &memory::sealed(PAGE));
            },
        ));
    }
    rows
}
