//! Clients on the ring lane that break SPEC lose their link. No other client loses a call.

// Shows CALL-CANCEL, RNG-HOSTILE, DAT-LOCAL (test, full).

use std::{
    collections::BTreeMap,
    sync::{
        Arc,
        atomic::{AtomicBool, Ordering},
    },
    thread::{self, JoinHandle},
    time::Duration,
};

use sm2_node::{Client, Node, Server};
use sm2_proto::{
    ViolationKind,
    link::{At, RingMemory},
};
use sm2_tests::{
    TIMEOUT,
    control::{self, Qos},
    domain::TempDomain,
    eventually,
    link::{Open, cancel, doorbell, kind, role},
    pattern,
    random::Random,
    raw::{RawLink, RawNode},
    ring::{PAGE, RawReceiver, RawSender, cell_word, head, is_in_slot, word},
};

/// A node that offers the ring lane, whatever the environment sets.
fn node(domain: &TempDomain, name: &str) -> Node {
    let builder = Node::builder(name).socket(domain.socket());
    builder.ring_lane(true).connect().expect("a node")
}

/// A server that echoes requests, and whose node runs on a separate thread.
struct Victim {
    friend: Client<[u8], [u8]>,
    stop: Arc<AtomicBool>,
    thread: Option<JoinHandle<()>>,
}

impl Victim {
    fn new(domain: &TempDomain) -> Self {
        let server = node(domain, "victim").server_builder::<[u8], [u8]>("s");
        let server = server.depth(4).max_borrowed(2).declare().expect("a server");
        let stop = Arc::new(AtomicBool::new(false));
        let stopped = Arc::clone(&stop);
        let thread = thread::spawn(move || {
            while !stopped.load(Ordering::Relaxed) {
                serve(&server);
            }
        });
        let friend = node(domain, "friend").client("s").expect("a client");
        friend.wait_for_servers_timeout(1, TIMEOUT).expect("a link");
        let victim = Self {
            friend,
            stop,
            thread: Some(thread),
        };
        victim.answers_its_friend();
        assert!(victim.friend.links()[0].ring);
        victim
    }

    #[track_caller]
    fn answers_its_friend(&self) {
        for len in [0, 100, 10_000] {
            let asked = pattern::message(len as u64, len);
            let reply = self.friend.call_timeout(&asked, TIMEOUT).expect("a reply");
            assert!(*reply == *asked, "{len} bytes");
        }
    }
}

fn serve(server: &Server<[u8], [u8]>) {
    let request = server.recv_timeout(Duration::from_millis(5));
    if let Some(request) = request.expect("a request") {
        let bytes = request.to_vec();
        // The raw client may have closed.
        let _ = request.reply(&bytes);
    }
}

impl Drop for Victim {
    fn drop(&mut self) {
        self.stop.store(true, Ordering::Relaxed);
        let thread = self.thread.take().expect("until now");
        assert!(thread.join().is_ok() || thread::panicking());
    }
}

/// A raw client with three calls in flight.
struct RawCaller {
    _node: RawNode,
    link: RawLink,
    requests: RawSender,
    replies: RawReceiver,
}

impl RawCaller {
    const WINDOW: u32 = 4;

    fn new(domain: &TempDomain, name: &str) -> Self {
        let raw = RawNode::welcomed(&domain.socket(), name);
        let qos = Qos {
            depth: 1,
            max_borrowed: 3,
            ..Qos::PLAIN
        };
        raw.declare(1, &control::client("s", qos));
        let link = raw.linked();
        let open = Open::new(role::CALLER, link.id, Self::WINDOW).with_ring();
        link.end.send(open.bytes());
        assert_eq!(link.end.expect().bytes[0], kind::OPEN, "OPEN comes first");
        let replies = RawReceiver::new(3, Self::WINDOW);
        replies.offer(&link);
        Self {
            _node: raw,
            requests: RawSender::new(&link, 8),
            link,
            replies,
        }
    }

    /// Waits for the end of the link. Returns the name of its violation.
    #[track_caller]
    fn ending(&self) -> &'static str {
        let mut verdict = None;
        eventually("the end of the link", || {
            verdict = self.link.verdict();
            verdict.is_some()
        });
        verdict.expect("until now")
    }

    /// Does something that is illegal most of the time.
    fn misbehave(&mut self, random: &mut Random, near: u64) {
        let (depth, window) = (self.requests.depth, self.requests.window);
        let bits = match random.within(0..8) {
            0 => random.next(),
            1 => 0,
            2 => random.within(0..3),
            3..5 => cell_word(
                random.within(0..110),
                u64::from(random.within(0..9) == 0),
                near + random.within(0..3),
            ),
            _ => word(1, random.within(0..9), near + random.within(0..3)),
        };
        match random.within(0..40) {
            // Rare, since two CANCELs for one call end the link.
            0 => drop((self.link.end).try_send(&cancel(near + random.within(0..4)), &[])),
            1..6 => {
                let slot = random.within(0..8) as usize;
                let mut head = head(near + random.within(0..2), random.within(0..9));
                head[24] = u8::from(random.within(0..9) == 0);
                self.requests.fill(slot, b"payload", head);
                let id = near + random.within(0..2);
                (self.requests).fill_cell(near + random.within(0..3), id, &[7; 104]);
            }
            6..11 => drop(
                self.requests
                    .ring
                    .swap(At::Back(random.within(0..window.into()) as u32), bits),
            ),
            11..16 => drop(
                self.replies
                    .ring
                    .swap(At::Back(random.within(0..4) as u32), bits),
            ),
            16..21 => drop(
                self.replies
                    .ring
                    .swap(At::Forward(random.within(0..3) as u32), bits),
            ),
            _ => {
                let index = random.within(0..depth.into()) as u32;
                self.requests.ring.swap(At::Forward(index), bits);
            }
        }
    }
}

/// A violation, and what commits it as the first call.
type Script = (ViolationKind, fn(&mut RawSender));

/// One script for each of several kinds.
const SCRIPTS: [Script; 8] = [
    (ViolationKind::BadWord, |it| {
        it.put(1, word(1, 0, 2));
    }),
    (ViolationKind::UnknownSegment, |it| {
        it.put(1, word(2, 0, 1));
    }),
    (ViolationKind::BadSlot, |it| {
        it.put(1, word(1, 8, 1));
    }),
    (ViolationKind::BadLength, |it| {
        it.fill(0, b"payload", head(1, PAGE));
        it.put(1, word(1, 0, 1));
    }),
    (ViolationKind::ReservedNotZero, |it| {
        let mut head = head(1, 7);
        head[63] = 1;
        it.fill(0, b"payload", head);
        it.put(1, word(1, 0, 1));
    }),
    (ViolationKind::BadWord, |it| {
        it.put(1, cell_word(105, 0, 1));
    }),
    (ViolationKind::BadId, |it| {
        it.fill_cell(1, 0, b"payload");
        it.put(1, cell_word(7, 0, 1));
    }),
    (ViolationKind::ReservedNotZero, |it| {
        it.fill_cell(1, 1, b"payload");
        it.put(1, cell_word(7, 1, 1));
    }),
];

//= SM2-RNG-004, SM2-RNG-007, SM2-SRV-001 sys
#[test]
fn a_client_that_breaks_a_rule_hears_which_one() {
    let domain = TempDomain::new();
    let _manager = domain.manager();
    let victim = Victim::new(&domain);
    for (kind, commit) in SCRIPTS {
        let mut raw = RawCaller::new(&domain, "raw");
        commit(&mut raw.requests);
        raw.requests.bell(&raw.link);
        assert_eq!(raw.ending(), kind.name());
        victim.answers_its_friend();
    }
}

//= SM2-RNG-004, SM2-RNG-007, SM2-RNG-008, SM2-RNG-011, SM2-SRV-001 sys
#[test]
fn a_client_that_writes_anything_anywhere_loses_its_link_alone() {
    let mut random = Random::seeded();
    let domain = TempDomain::new();
    let _manager = domain.manager();
    let victim = Victim::new(&domain);
    let mut verdicts = BTreeMap::new();
    for round in 0..60 {
        let mut raw = RawCaller::new(&domain, &format!("raw-{round}"));
        // Correct requests first, so that the server is busy with some.
        let good = random.within(0..3);
        for id in 1..=good {
            raw.requests.send(id, id as usize, b"payload");
        }
        raw.requests.bell(&raw.link);
        let mut verdict = None;
        eventually("the end of the link", || {
            // Few at a time, and time for the server to look, so that any of them may be the first.
            for _ in 0..=random.within(0..3) {
                raw.misbehave(&mut random, good + 1);
            }
            // Wakes the server whether or not it is parked, so that it looks in any case.
            let _ = raw.link.end.try_send(&doorbell(), &[]);
            verdict = raw.link.verdict();
            verdict.is_some()
        });
        *verdicts.entry(verdict).or_insert(0) += 1;
        for _ in 0..10_000 {
            raw.misbehave(&mut random, good + 1);
        }
        victim.answers_its_friend();
    }
    println!("{verdicts:?}");
}

/// CANCEL arrives on the socket before the request is in the ring, and long after its reply.
//= SM2-RNG-011 sys
#[test]
fn a_cancel_may_come_before_its_request_and_after_its_reply() {
    let domain = TempDomain::new();
    let _manager = domain.manager();
    let victim = Victim::new(&domain);
    let mut raw = RawCaller::new(&domain, "raw");
    let mut given = 0;
    for id in 1..=20_u64 {
        if id % 2 == 0 {
            raw.link.end.send(cancel(id));
        }
        if id % 5 == 0 {
            victim.answers_its_friend();
        }
        // Its reply needs a slot.
        raw.requests.send(id, (id % 8) as usize, &[7; 200]);
        raw.requests.bell(&raw.link);
        let mut reply = None;
        eventually("a reply", || {
            reply = reply.or_else(|| raw.replies.take(id));
            reply.is_some()
        });
        // A reply in a slot is given back; one in a cell is not.
        let reply = reply.expect("taken");
        if is_in_slot(reply) {
            raw.replies.give(given, reply);
            given += 1;
        } else {
            assert_eq!(raw.replies.in_cell(reply).0, id, "its call");
        }
        eventually("its request back", || raw.requests.harvest(id - 1) != 0);
        raw.link.end.send(cancel(id));
        assert_eq!(raw.link.verdict(), None);
    }
    victim.answers_its_friend();
    assert_eq!(raw.link.verdict(), None);
    // And a CANCEL for a call that is never made: the server must read it before the request that
    // shows that.
    raw.link.end.send(cancel(21));
    eventually("the CANCEL is read", || raw.link.end.is_read());
    raw.requests.fill(0, b"payload", head(22, 7));
    raw.requests.put(21, word(1, 0, 21));
    raw.requests.bell(&raw.link);
    assert_eq!(raw.ending(), "unknown-call");
    victim.answers_its_friend();
}
