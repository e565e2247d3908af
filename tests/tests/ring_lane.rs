//! Peers on the ring lane that break SPEC lose their link, and no other link is affected. (Each
//! single violation is a row of the table: see `violations.rs`.)

// Shows RNG-HOSTILE, DAT-LOCAL (test, full).

use std::{
    os::fd::AsFd,
    sync::atomic::{AtomicBool, Ordering},
    thread,
};

use nix::fcntl::{FallocateFlags, fallocate};
use sm2_io::SendError;
use sm2_proto::{
    Seals, ViolationKind,
    link::{At, RingMemory},
};
use sm2_tests::{
    actor::{Actor, number},
    control::{self, Qos},
    domain::TempDomain,
    eventually,
    link::{Open, detach, doorbell, kind, ring, role},
    memory, pattern,
    random::Random,
    raw::{RawLink, RawNode},
    ring::{PAGE, RawReceiver, RawSender, cell_word, size, word},
};

const RING: [&str; 2] = ["--ring-lane", "on"];

/// A node that offers the ring lane, whatever the environment sets.
fn node(domain: &TempDomain, name: &str) -> Actor {
    let actor = Actor::launch(&domain.socket(), name, &RING);
    assert_eq!(actor.answer(), "ready", "{name}");
    actor
}

/// A subscriber of `t`, which a raw publisher attacks, and of `by`, where an honest publisher
/// sends.
struct Victim {
    actor: Actor,
    friend: Actor,
    _raw: RawNode,
    link: RawLink,
}

impl Victim {
    fn new(domain: &TempDomain, demand: &str) -> Self {
        let mut actor = node(domain, "victim");
        actor.tell(&format!("sub t t {demand}"));
        actor.tell("sub by by reliable");
        let mut friend = node(domain, "friend");
        friend.tell("pub by by reliable_ms=60000");
        friend.tell("wait by 1");
        let raw = RawNode::welcomed(&domain.socket(), "raw");
        raw.declare(1, &control::publisher("t", Qos::RELIABLE));
        let link = raw.linked();
        Self {
            actor,
            friend,
            _raw: raw,
            link,
        }
    }

    /// Asserts that messages from the friend still arrive intact.
    #[track_caller]
    fn hears_its_friend(&mut self) {
        self.friend.tell("publish by 2 5000");
        let taken = self.actor.tell("take by 2");
        assert!(taken.ends_with("lost=0 damaged=0"), "{taken}");
    }
}

/// A random word of a ring.
fn somewhere(random: &mut Random, depth: u16, window: u32) -> At {
    match random.within(0..8) {
        0 => At::ReceiverParked,
        1 => At::SenderParked,
        2..=5 => At::Forward(random.within(0..depth.into()) as u32),
        _ => At::Back(random.within(0..window.into()) as u32),
    }
}

/// Random bits, often close to a correct word.
fn something(random: &mut Random, near: u64) -> u64 {
    match random.within(0..8) {
        0 => random.next(),
        1 => 0,
        2 => random.within(0..3),
        6 => cell_word(
            random.within(0..110),
            u64::from(random.within(0..9) == 0),
            near + random.within(0..9),
        ),
        7 => cell_word(random.within(0..105), 0, near + random.within(0..3)),
        3 => word(
            random.within(0..4),
            random.within(0..16),
            near + random.within(0..9),
        ),
        _ => word(1, random.within(0..8), near + random.within(0..3)),
    }
}

//= SM2-RNG-004, SM2-RNG-007, SM2-RNG-008 sys
#[test]
fn a_publisher_that_writes_anything_anywhere_loses_its_link_alone() {
    const WRITES: usize = 2_000_000;
    let mut random = Random::new(1);
    let (mut written, mut verdicts) = (0, std::collections::BTreeMap::new());
    for round in 0.. {
        let domain = TempDomain::new();
        let _manager = domain.manager();
        let demand = ["depth=4 borrow=2", "depth=8 borrow=4 reliable"][round % 2];
        let mut victim = Victim::new(&domain, demand);
        let mut sender = RawSender::open(&victim.link, 8);
        for slot in 0..8 {
            sender.fill(slot, b"payload", sm2_tests::ring::head(slot as u64 + 1, 7));
        }
        // While the subscriber receives, and at once sees the words written.
        let verdict = loop {
            victim.actor.say("drain t");
            for _ in 0..2_000 {
                let at = somewhere(&mut random, sender.depth, sender.window);
                sender.ring.swap(at, something(&mut random, 0));
                let sequence = random.within(0..9);
                sender.fill_cell(sequence, random.within(0..9), &[7; 104]);
                written += 1;
            }
            victim.actor.answer();
            if let Some(verdict) = victim.link.verdict() {
                break verdict;
            }
        };
        *verdicts.entry(verdict).or_insert(0) += 1;
        // The victim has closed the link, so any words may be written now.
        for _ in 0..WRITES / 8 {
            let at = somewhere(&mut random, sender.depth, sender.window);
            sender.ring.swap(at, something(&mut random, 0));
            written += 1;
        }
        victim.hears_its_friend();
        let drained = victim.actor.tell("drain t");
        assert_eq!(number(&drained, "got"), 0, "after the end: {drained}");
        if written >= WRITES {
            break;
        }
    }
    println!("{written} words: {verdicts:?}");
}

/// Words change between the receiver's load and its take. The receiver's work is bounded, and
/// messages of other publishers on the same topic arrive.
//= SM2-RNG-007 sys
#[test]
fn a_publisher_that_changes_words_in_front_of_the_receiver_stops_nobody() {
    let domain = TempDomain::new();
    let _manager = domain.manager();
    let mut victim = Victim::new(&domain, "depth=4 borrow=2");
    let sender = RawSender::open(&victim.link, 8);
    let mut other = node(&domain, "other");
    other.tell("pub t t");
    other.tell("wait t 1");
    let done = AtomicBool::new(false);
    thread::scope(|scope| {
        scope.spawn(|| {
            // Alternately a message of this round and one of a later round, at every index.
            for n in (1_u64..).take_while(|_| !done.load(Ordering::Relaxed)) {
                for index in 0..4 {
                    sender
                        .ring
                        .swap(At::Forward(index), word(1, 7, n * 4 + u64::from(index)));
                }
            }
        });
        for _ in 0..20 {
            other.tell("publish t 1 1000");
            eventually("a message of the other publisher", || {
                let drained = victim.actor.ask("drain t");
                drained.contains("bytes=1000")
            });
            victim.hears_its_friend();
        }
        done.store(true, Ordering::Relaxed);
    });
}

//= SM2-RNG-012 sys
#[test]
fn a_flood_of_doorbells_stops_nobody() {
    let domain = TempDomain::new();
    let _manager = domain.manager();
    let mut victim = Victim::new(&domain, "");
    let sender = &mut RawSender::open(&victim.link, 8);
    let mut rang = 0;
    for n in 1..=50 {
        for _ in 0..2_000 {
            match victim.link.end.try_send(&doorbell(), &[]) {
                Ok(()) => rang += 1,
                Err(SendError::WouldBlock) => {}
                Err(error) => panic!("{error} after {n} messages: {:?}", victim.link.verdict()),
            }
        }
        assert_eq!(sender.send(n, n as usize % 8, &pattern::message(n, 100)), 0);
        sender.bell(&victim.link);
        victim.hears_its_friend();
        let taken = victim.actor.tell("take t 1");
        assert!(taken.ends_with("lost=0 damaged=0"), "{taken}");
        assert_eq!(sender.harvest(n - 1), word(1, n % 8, n));
    }
    assert!(rang > 2_000, "{rang}");
    assert_eq!(victim.link.verdict(), None);
}

/// The publisher agrees on a ring and then does nothing more.
//= SM2-RNG-002 sys
#[test]
fn a_publisher_that_never_maps_the_ring_stops_nobody() {
    let domain = TempDomain::new();
    let _manager = domain.manager();
    let mut victim = Victim::new(&domain, "");
    let open = Open::new(role::SENDER, victim.link.id, 0).with_ring();
    victim.link.end.send(open.bytes());
    let mut other = node(&domain, "other");
    other.tell("pub t t");
    other.tell("wait t 1");
    for _ in 0..20 {
        other.tell("publish t 1 1000");
        let taken = victim.actor.tell("take t 1");
        assert!(taken.ends_with("lost=0 damaged=0"), "{taken}");
        victim.hears_its_friend();
    }
    assert_eq!(victim.link.verdict(), None);
}

/// When a publisher is killed, only the messages left in the ring can still be taken.
//= SM2-RNG-010 sys
#[test]
fn what_a_killed_publisher_left_in_the_ring_is_there() {
    for (offer, size) in [("", 5_000), ("reliable_ms=60000", 5_000), ("", 100)] {
        let domain = TempDomain::new();
        let _manager = domain.manager();
        let mut listener = node(&domain, "listener");
        listener.tell("sub t t depth=8 borrow=8");
        let before = listener.census();
        let mut talker = node(&domain, "talker");
        talker.tell(&format!("pub t t {offer}"));
        talker.tell("wait t 1");
        talker.tell(&format!("publish t 30 {size}"));
        talker.kill();
        let drained = listener.tell("drain t");
        let bytes = 8 * size;
        let expected = format!("got=8 bytes={bytes} first=23 last=30 lost=22 damaged=0");
        assert_eq!(drained, expected);
        eventually("the end of the link", || {
            listener.ask("drain t");
            listener.census().of_kind("socket") == 1
        });
        before.restored(listener.pid());
    }
}

/// A talker with a healthy listener, and a raw subscriber that breaks SPEC.
struct Talk {
    talker: Actor,
    listener: Actor,
    _raw: RawNode,
    link: RawLink,
}

impl Talk {
    fn new(domain: &TempDomain, offer: &str, qos: Qos) -> Self {
        let mut talker = node(domain, "talker");
        talker.tell(&format!("pub t t depth=8 {offer}"));
        let mut listener = node(domain, "listener");
        let demand = if qos.reliable { "reliable" } else { "" };
        listener.tell(&format!("sub t t depth=64 {demand}"));
        talker.tell("wait t 1");
        let raw = RawNode::welcomed(&domain.socket(), "raw");
        raw.declare(1, &control::subscriber("t", qos));
        let link = raw.linked();
        Self {
            talker,
            listener,
            _raw: raw,
            link,
        }
    }

    /// Asserts that the listener gets every message.
    #[track_caller]
    fn publish(&mut self, count: u64, size: usize) -> String {
        let published = self.talker.tell(&format!("publish t {count} {size}"));
        let taken = self.listener.tell(&format!("take t {count}"));
        assert!(taken.ends_with("lost=0 damaged=0"), "{taken}");
        published
    }
}

/// A receiver agrees on a ring, and makes it late or never.
//= SM2-RNG-002 sys
#[test]
fn a_ring_that_never_comes_is_not_waited_for() {
    for (offer, qos) in [("", Qos::PLAIN), ("reliable_ms=60000", Qos::RELIABLE)] {
        let domain = TempDomain::new();
        let _manager = domain.manager();
        let mut talk = Talk::new(&domain, offer, qos);
        let open = Open::new(role::RECEIVER, talk.link.id, 6).with_ring();
        talk.link.end.send(open.bytes());
        assert_eq!(talk.link.end.expect().bytes[0], kind::OPEN);
        for _ in 0..4 {
            let published = talk.publish(10, 5_000);
            assert_eq!(published, "took=10 missed=0");
        }
        assert!(talk.link.end.is_quiet(), "no message comes before RING");
        let receiver = RawReceiver::new(4, 6);
        receiver.offer(&talk.link);
        talk.talker.tell("wait t 2");
        assert_eq!(talk.publish(1, 5_000), "took=2 missed=0");
        assert_eq!(talk.link.end.expect().bytes[0], kind::ATTACH);
        assert!(receiver.take(1).is_some(), "the first message of this link");
    }
}

/// A receiver takes nothing: its own messages are displaced, or dropped after the deadline.
//= SM2-RNG-005, SM2-QOS-001, SM2-QOS-002 sys
#[test]
fn a_ring_that_is_never_emptied_costs_its_receiver_alone() {
    for (offer, qos) in [("", Qos::PLAIN), ("reliable_ms=30", Qos::RELIABLE)] {
        let domain = TempDomain::new();
        let _manager = domain.manager();
        let mut talk = Talk::new(&domain, offer, qos);
        let receiver = RawReceiver::open(&talk.link, 4, 6);
        talk.talker.tell("wait t 2");
        for _ in 0..10 {
            talk.publish(32, 5_000);
        }
        let count = talk.talker.counted_with("t", "raw");
        assert!(count.open);
        assert_eq!((count.offered, count.in_flight), (320, 4));
        let reason = if qos.reliable { "no_room" } else { "discarded" };
        assert_eq!(count.of(reason), 316);
        // A reliable link keeps the oldest message, a best-effort link the newest.
        let first = if qos.reliable { 1 } else { 317 };
        let words: Vec<_> = (first..first + 4)
            .filter_map(|n| receiver.take(n))
            .collect();
        assert_eq!(words.len(), 4);
        (0..).zip(&words).for_each(|(n, bits)| {
            assert_eq!(receiver.give(n, *bits), 0);
        });
        eventually("all of them to be back", || {
            talk.talker.counted_with("t", "raw").delivered == 4
        });
    }
}

/// A receiver empties cells without reading them, and puts their words back: its own messages count as delivered or as
/// not taken. A word that comes back where the sender has settled the message ends the link.
//= SM2-RNG-005, SM2-RNG-013 sys
#[test]
fn a_subscriber_that_empties_and_refills_cells_costs_itself_alone() {
    for (offer, qos) in [("", Qos::PLAIN), ("reliable_ms=30", Qos::RELIABLE)] {
        let domain = TempDomain::new();
        let _manager = domain.manager();
        let mut talk = Talk::new(&domain, offer, qos);
        let receiver = RawReceiver::open(&talk.link, 4, 6);
        talk.talker.tell("wait t 2");
        talk.publish(4, 100);
        let words = [0, 1, 2, 3].map(|it| receiver.ring.swap(At::Forward(it), 0));
        eventually("all of them to count as delivered", || {
            talk.talker.counted_with("t", "raw").delivered == 4
        });
        // The next messages fill the empty cells, and are emptied and put back before the sender looks again.
        talk.publish(4, 100);
        for index in 0..4 {
            let bits = receiver.ring.swap(At::Forward(index), 0);
            let (id, payload) = receiver.in_cell(bits);
            assert!(pattern::is_intact(&payload, id), "message {id}");
            receiver.ring.swap(At::Forward(index), bits);
        }
        let count = talk.talker.counted_with("t", "raw");
        assert_eq!((count.delivered, count.in_flight), (4, 4));
        talk.publish(4, 100);
        let count = talk.talker.counted_with("t", "raw");
        let reason = if qos.reliable { "no_room" } else { "discarded" };
        assert!(count.open);
        assert_eq!((count.of(reason), count.in_flight), (4, 4), "{count:?}");
        for (index, bits) in (0..).zip(words) {
            receiver.ring.swap(At::Forward(index), bits);
        }
        // A reliable sender waits for words that it does not know; another one displaces them.
        talk.publish(1, 100);
        if !qos.reliable {
            let code = ViolationKind::BadWord.code().0;
            assert_eq!(talk.link.closed(), Some(code));
        }
        talk.publish(20, 100);
    }
}

/// Holes in the file: words become zero, and neither side faults.
#[test]
fn holes_in_a_ring_are_no_fault() {
    for (offer, qos) in [("", Qos::PLAIN), ("reliable_ms=30", Qos::RELIABLE)] {
        let domain = TempDomain::new();
        let _manager = domain.manager();
        let mut talk = Talk::new(&domain, offer, qos);
        let receiver = RawReceiver::open(&talk.link, 4, 6);
        talk.talker.tell("wait t 2");
        let punch = FallocateFlags::FALLOC_FL_PUNCH_HOLE | FallocateFlags::FALLOC_FL_KEEP_SIZE;
        for _ in 0..20 {
            talk.talker.say("publish t 20 5000");
            for _ in 0..200 {
                fallocate(&receiver.file, punch, 0, PAGE as i64).expect("a hole");
            }
            talk.talker.answer();
            let taken = talk.listener.tell("take t 20");
            assert!(taken.ends_with("lost=0 damaged=0"), "{taken}");
        }
        // The messages taken in this way were never given back.
        let link = talk.talker.counted_with("t", "raw");
        assert!(!link.open || link.in_flight <= 6, "{link:?}");
    }
}

/// Random words at random places while the talker publishes.
//= SM2-RNG-005, SM2-RNG-008 sys
#[test]
fn a_subscriber_that_writes_anything_anywhere_loses_its_link_alone() {
    let mut random = Random::new(2);
    let mut verdicts = std::collections::BTreeMap::new();
    for round in 0..12 {
        let domain = TempDomain::new();
        let _manager = domain.manager();
        let (offer, qos) = [("", Qos::PLAIN), ("reliable_ms=30", Qos::RELIABLE)][round % 2];
        let mut talk = Talk::new(&domain, offer, qos);
        let receiver = RawReceiver::open(&talk.link, 4, 6);
        talk.talker.tell("wait t 2");
        let mut near = 0;
        while talk.talker.counted_with("t", "raw").open {
            near += 8;
            talk.talker.say("publish t 8 100");
            for _ in 0..2_000 {
                let at = somewhere(&mut random, 4, 6);
                receiver.ring.swap(at, something(&mut random, near));
            }
            talk.talker.answer();
            let taken = talk.listener.tell("take t 8");
            assert!(taken.ends_with("lost=0 damaged=0"), "{taken}");
        }
        let code = talk.link.closed().expect("CLOSE");
        let violation = ViolationKind::from_code(sm2_proto::Code(code)).expect("a violation");
        *verdicts.entry(violation.name()).or_insert(0) += 1;
        talk.publish(20, 5_000);
    }
    println!("{verdicts:?}");
}

/// RING with a file that cannot be mapped for writing is a violation.
//= SM2-RNG-002 test
#[test]
fn a_ring_that_is_not_open_for_writing_costs_its_receiver_alone() {
    let domain = TempDomain::new();
    let _manager = domain.manager();
    let mut talk = Talk::new(&domain, "", Qos::PLAIN);
    let open = Open::new(role::RECEIVER, talk.link.id, 6).with_ring();
    talk.link.end.send(open.bytes());
    let file = memory::memfd(size(4, 6), Seals::RING);
    let read_only = memory::reopened(&file);
    talk.link.end.send_fds(ring(4, 6), &[read_only.as_fd()]);
    let code = ViolationKind::NotAMemfd.code().0;
    assert_eq!(talk.link.closed(), Some(code));
    talk.publish(20, 5_000);
}

/// DETACH while words of the segment are in the ring, which SPEC forbids.
#[test]
fn a_segment_that_goes_with_messages_in_the_ring_costs_its_publisher_alone() {
    let domain = TempDomain::new();
    let _manager = domain.manager();
    let mut victim = Victim::new(&domain, "");
    let mut sender = RawSender::open(&victim.link, 8);
    for n in 1..=4 {
        sender.send(n, n as usize, &pattern::message(n, 100));
    }
    victim.link.end.send(detach(1));
    assert_eq!(victim.link.end.expect().bytes[0], kind::DETACHED);
    let drained = victim.actor.tell("drain t");
    assert_eq!(number(&drained, "got"), 0);
    assert_eq!(victim.link.verdict(), Some("unknown-segment"));
    victim.hears_its_friend();
}
