//! Messages from 0 bytes to 256 MiB (8 MiB without the feature `slow`) arrive intact in every form that they can have.

use std::os::fd::AsFd;

use sm2_tests::{
    actor::Actor,
    control::{self, Qos},
    domain::TempDomain,
    link::{Head, Open, attach, form, kind, release, role},
    memory,
    raw::{RawLink, RawNode},
};

const PAGE: usize = 4096;
const MIB: usize = 1 << 20;
/// The greatest length of a message.
const MOST: usize = if cfg!(feature = "slow") { 256 } else { 8 } * MIB;
/// The greatest length of a request.
const MOST_OF_CALLS: usize = if cfg!(feature = "slow") { 32 } else { 3 } * MIB;

/// A raw subscriber that sees the form of each message.
struct Observer {
    _node: RawNode,
    link: RawLink,
}

impl Observer {
    fn new(domain: &TempDomain) -> Self {
        let node = RawNode::welcomed(&domain.socket(), "observer");
        node.declare(1, &control::subscriber("t", Qos::PLAIN));
        let link = node.linked();
        link.end.send(Open::new(role::RECEIVER, link.id, 6).bytes());
        assert_eq!(link.end.expect().bytes[0], kind::OPEN);
        Self { _node: node, link }
    }

    /// Returns the form of the next message, and releases it.
    fn form(&self) -> u8 {
        loop {
            let frame = self.link.end.expect();
            let bytes = frame.bytes;
            if bytes[0] == kind::DATA {
                assert_eq!(frame.fds.len(), usize::from(bytes[1] == form::SEALED));
                let sequence = u64::from_le_bytes(bytes[16..24].try_into().expect("8 bytes"));
                self.link.end.send(release(0, &[sequence]));
                return bytes[1];
            }
            assert!(
                [kind::ATTACH, kind::DETACH].contains(&bytes[0]),
                "{bytes:?}"
            );
        }
    }
}

/// Publishes one message of each size, to a reliable and to a best-effort subscriber.
fn carry(offer: &str, form: u8, sizes: &[usize]) {
    let domain = TempDomain::new();
    let _manager = domain.manager();
    let mut talker = Actor::start(&domain.socket(), "talker");
    let mut listeners = ["reliable", ""].map(|demand| {
        let mut listener = Actor::start(&domain.socket(), &format!("listener-{demand}x"));
        listener.tell(&format!("sub t t {demand}"));
        listener
    });
    talker.tell(&format!("pub t t reliable_ms=60000 {offer}"));
    let observer = Observer::new(&domain);
    talker.tell("wait t 3");
    for (number, size) in (1..).zip(sizes) {
        talker.tell(&format!("publish t 1 {size}"));
        // An empty message needs no shared memory.
        let expected = if *size == 0 { form::INLINE } else { form };
        assert_eq!(observer.form(), expected, "{size} bytes");
        for listener in &mut listeners {
            let taken = listener.tell("take t 1");
            let intact =
                format!("got=1 bytes={size} first={number} last={number} lost=0 damaged=0");
            assert_eq!(taken, intact, "{size} bytes");
        }
    }
}

//= SM2-PAY-002 sys
#[test]
fn inline_messages_arrive_intact() {
    let sizes = [0, 1, 47, 48, PAGE - 1, PAGE, PAGE + 1, 61_439, 61_440];
    carry("inline_max=61440", form::INLINE, &sizes);
}

//= SM2-PAY-003 sys
#[test]
fn pooled_messages_arrive_intact() {
    let sizes = [
        0,
        1,
        PAGE - 1,
        PAGE,
        PAGE + 1,
        MIB - 1,
        MIB,
        MIB + 1,
        MOST,
        1,
    ];
    carry("inline_max=0", form::POOLED, &sizes);
}

//= SM2-PAY-004 sys
#[test]
fn sealed_messages_arrive_intact() {
    let sizes = [0, 1, PAGE - 1, PAGE, PAGE + 1, MIB, 2 * MIB + 1, MOST, 1];
    carry("inline_max=0 sealed", form::SEALED, &sizes);
}

/// The library never uses shared memory for an empty message; another implementation may.
//= SM2-PAY-003, SM2-PAY-004 sys
#[test]
fn empty_messages_in_shared_memory_are_messages() {
    let domain = TempDomain::new();
    let _manager = domain.manager();
    let mut listener = Actor::start(&domain.socket(), "listener");
    listener.tell("sub t t");
    let talker = RawNode::welcomed(&domain.socket(), "talker");
    talker.declare(1, &control::publisher("t", Qos::PLAIN));
    let link = talker.linked();
    link.open(role::SENDER, 0);
    let (segment, empty) = (memory::segment(PAGE as u64), memory::sealed(0));
    link.end
        .send_fds(attach(9, PAGE as u64, 1), &[segment.as_fd()]);
    let head = |n, form, segment| Head {
        form,
        segment,
        ..Head::nth(kind::DATA, n)
    };
    link.end.send(head(1, form::INLINE, 0).bytes());
    link.end.send(head(2, form::POOLED, 9).bytes());
    link.end
        .send_fds(head(3, form::SEALED, 0).bytes(), &[empty.as_fd()]);
    let taken = listener.tell("take t 3");
    assert_eq!(taken, "got=3 bytes=0 first=1 last=3 lost=0 damaged=0");
}

//= SM2-SRV-002 sys
#[test]
fn requests_and_replies_of_every_size_arrive_intact() {
    for (inline, sealed) in [
        ("inline_max=61440", ""),
        ("inline_max=0", ""),
        ("inline_max=0", "sealed"),
    ] {
        let domain = TempDomain::new();
        let _manager = domain.manager();
        let mut server = Actor::start(&domain.socket(), "server");
        let mut client = Actor::start(&domain.socket(), "client");
        server.tell(&format!("server s s {inline}"));
        client.tell(&format!("client s s {inline} {sealed}"));
        client.tell("wait s 1");
        for size in [0, 1, 104, 105, PAGE - 1, PAGE, PAGE + 1, MIB, MOST_OF_CALLS] {
            client.tell(&format!("call s {size}"));
            server.tell("serve s 1");
            let reply = client.tell("reply s");
            let intact = reply.contains(&format!("bytes={size} ")) && reply.contains("damaged=0");
            assert!(intact, "{size}: {reply}");
        }
    }
}
