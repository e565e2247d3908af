//! Guarantees for the memory that a receiver reads while other processes write, close and die.

// Shows DAT-ONCE, DAT-REFS, DAT-SEALED (test, full).

use std::{
    fs::{self, File},
    os::{fd::AsFd, unix::fs::FileExt},
};

use nix::sys::signal::Signal;
use sm2_io::Segment;
use sm2_proto::{Farewell, control::ToNode};
use sm2_tests::{
    actor::{Actor, number},
    census,
    control::{self, Qos},
    domain::TempDomain,
    eventually,
    link::{attach, close, kind, pooled, release, role, sealed},
    memory, pattern,
    raw::{RawLink, RawNode},
};

const PAGE: u64 = 4096;

/// A raw publisher that is linked with a subscriber of a real node.
fn linked(domain: &TempDomain, demand: &str) -> (RawNode, RawLink, Actor) {
    let mut listener = Actor::start(&domain.socket(), "listener");
    listener.tell(&format!("sub t t {demand}"));
    let talker = RawNode::welcomed(&domain.socket(), "talker");
    talker.declare(1, &control::publisher("t", Qos::RELIABLE));
    let link = talker.linked();
    link.open(role::SENDER, 0);
    (talker, link, listener)
}

//= SM2-PAY-007 sys
#[test]
fn a_receiver_maps_for_reading_only() {
    let domain = TempDomain::new();
    let _manager = domain.manager();
    let (_talker, link, mut listener) = linked(&domain, "borrow=4");
    let segment = memory::segment(2 * PAGE);
    let message = memory::sealed(PAGE);
    link.end.send_fds(attach(1, PAGE, 2), &[segment.as_fd()]);
    link.end.send(pooled(kind::DATA, 1, 1, 0, 10));
    link.end
        .send_fds(sealed(kind::DATA, 2, 10), &[message.as_fd()]);
    listener.tell("hold t 2");
    let permissions = census::permissions(listener.pid());
    assert_eq!(permissions, ["r--s", "r--s"]);
    // No mapping and no descriptor of them is left.
    let held = listener.census();
    listener.tell("free t");
    link.end.send(close(0));
    eventually("the mappings to go", || listener.census().mappings() == 0);
    assert_eq!(held.of_kind("memfd:sm2-test"), 0);
}

/// A publisher breaks SPEC and overwrites lent memory. The receiver uses the length and form that
/// the datagram stated.
//= SM2-PAY-006 sys
#[test]
fn lengths_come_from_the_datagram_whatever_stands_in_memory() {
    let domain = TempDomain::new();
    let _manager = domain.manager();
    let (_talker, link, mut listener) = linked(&domain, "borrow=4 reliable");
    let (segment, mut slots) = Segment::create(PAGE, 2).expect("a segment").split();
    link.end.send_fds(attach(1, PAGE, 2), &[segment.as_fd()]);
    // Bytes that look like a header, around the message and in it.
    slots
        .iter_mut()
        .for_each(|slot| slot.bytes_mut(4096).fill(0xff));
    let message = pattern::message(1, 1000);
    slots[1].bytes_mut(1000).copy_from_slice(&message);
    link.end.send(pooled(kind::DATA, 1, 1, 1, 1000));
    let taken = listener.tell("hold t 1");
    assert_eq!(taken, "got=1 bytes=1000 first=1 last=1 lost=0 damaged=0");
    // While the receiver reads them.
    let mut damaged = 0;
    for n in 2..200 {
        link.end.send(pooled(kind::DATA, n, 1, 0, n));
        listener.say("take t 1");
        for byte in 0..=255 {
            slots[0].bytes_mut(4096).fill(byte);
        }
        let taken = listener.answer();
        assert!(
            taken.contains(&format!("got=1 bytes={n} first={n} last={n}")),
            "{taken}"
        );
        damaged += number(&taken, "damaged");
    }
    // The publisher can do no more harm than this.
    println!("{damaged} of 198 messages were overwritten in time");
    assert_eq!(listener.tell("free t"), "freed=1");
}

//= SM2-OPN-007, SM2-OPN-009 sys
#[test]
fn what_was_received_outlives_its_publisher() {
    for offer in ["", "sealed"] {
        let domain = TempDomain::new();
        let _manager = domain.manager();
        let mut listener = Actor::start(&domain.socket(), "listener");
        listener.tell("sub t t depth=8 borrow=8");
        let before = listener.census();
        let mut talker = Actor::start(&domain.socket(), "talker");
        talker.tell(&format!("pub t t inline_max=0 {offer}"));
        talker.tell("wait t 1");
        talker.tell("publish t 4 100000");
        listener.tell("hold t 2");
        talker.kill();
        // Messages that are held or not taken yet stay intact.
        eventually("the end of the link", || {
            listener.census().of_kind("socket") == 1
        });
        let taken = listener.tell("take t 2");
        assert_eq!(taken, "got=2 bytes=200000 first=3 last=4 lost=0 damaged=0");
        assert_eq!(listener.tell("check t"), "got=2 damaged=0");
        listener.tell("free t");
        before.restored(listener.pid());
    }
}

/// A message that a program holds does not change when its link ends, on either side: the publisher does
/// not write to the slot again.
//= SM2-PAY-005 sys
#[test]
fn what_is_held_is_not_written_anew_when_its_link_ends() {
    for cause in ["dropped", "short"] {
        let domain = TempDomain::new();
        let _manager = domain.manager();
        let mut talker = Actor::start(&domain.socket(), "talker");
        talker.tell("pub t t inline_max=0 reliable_ms=60000");
        let mut holder = Actor::launch(&domain.socket(), "holder", &["--nofile", "64"]);
        assert_eq!(holder.answer(), "ready");
        let mut other = Actor::start(&domain.socket(), "other");
        holder.tell("sub t t borrow=8 reliable");
        other.tell("sub t t reliable");
        talker.tell("wait t 2");
        talker.tell("publish t 3 10000");
        other.tell("take t 3");
        holder.tell("hold t 3");
        if cause == "dropped" {
            holder.tell("withdraw t");
        } else {
            // The node cannot accept a further segment for lack of a descriptor, so the link ends.
            holder.tell("eat");
            talker.tell("publish t 1 1000000");
            other.tell("take t 1");
        }
        eventually("the end of the link", || {
            !talker.counted_with("t", "holder").open
        });
        // As many at a time as were held, so that their slots would be reused.
        for _ in 0..10 {
            talker.tell("publish t 6 10000");
            other.tell("take t 6");
        }
        assert_eq!(holder.tell("check t"), "got=3 damaged=0", "{cause}");
    }
}

const WITHOUT_SPY: &str = "\
default = \"allow\"

[[rule]]
effect = \"deny\"
actions = [\"subscribe\"]
names = [\"**\"]
nodes = [\"spy\"]
";

/// The bytes of all segments that a raw receiver gets.
fn contents(files: &[File]) -> Vec<Vec<u8>> {
    let content = |file: &File| {
        let mut bytes = vec![0; usize::try_from(file.metadata().unwrap().len()).unwrap()];
        file.read_exact_at(&mut bytes, 0).unwrap();
        bytes
    };
    files.iter().map(content).collect()
}

/// A receiver that the policy cuts off keeps its mapping, whatever it was told. No further message is written to it,
/// while the other receivers go on.
//= SM2-ACC-015 sys
#[test]
fn a_denied_receiver_finds_no_further_message_in_its_mapping() {
    let domain = TempDomain::new();
    let policy = domain.folder().join("robot.toml");
    fs::write(&policy, "default = \"allow\"\n").unwrap();
    let mut manager = domain.manager_with(&["--policy", policy.to_str().unwrap()]);
    let mut talker = Actor::start(&domain.socket(), "talker");
    talker.tell("pub t t inline_max=0");
    let mut listener = Actor::start(&domain.socket(), "listener");
    listener.tell("sub t t depth=64");
    let spy = RawNode::welcomed(&domain.socket(), "spy");
    spy.declare(1, &control::subscriber("t", Qos::PLAIN));
    let link = spy.linked();
    link.open(role::RECEIVER, 4);
    talker.tell("wait t 2");
    talker.tell("publish t 3 10000");
    listener.tell("take t 3");
    let mut files = Vec::new();
    let mut messages = 0;
    while messages < 3 {
        let frame = link.end.expect();
        if frame.bytes[0] == kind::DATA {
            messages += 1;
            let sequence = u64::from_le_bytes(frame.bytes[16..24].try_into().unwrap());
            // Its slot may serve the next message.
            link.end.send(release(0, &[sequence]));
        }
        files.extend(frame.fds.into_iter().map(File::from));
    }
    assert_eq!(files.len(), 1, "the segment of the messages");

    fs::write(&policy, WITHOUT_SPY).unwrap();
    manager.signal(Signal::SIGHUP);
    let mut answered = 0;
    while answered < 2 {
        match spy.next() {
            ToNode::DeclareRefused { .. } => spy.send(control::suspended(1)),
            ToNode::Unlink { link, code, .. } => {
                assert_eq!(code, Farewell::Denied.code());
                spy.send(control::unlinked(1, link, code.0));
            }
            other => panic!("{other:?}"),
        }
        answered += 1;
    }
    manager.log_says("the new access policy is applied");
    let before = contents(&files);
    talker.tell("publish t 40 10000");
    let taken = listener.tell("take t 40");
    assert!(taken.ends_with("last=43 lost=0 damaged=0"), "{taken}");
    assert!(before == contents(&files), "a denied process has read on");
}
