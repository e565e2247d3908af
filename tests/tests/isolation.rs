//! A subscriber or client that misbehaves affects no other: the others get every message, and the
//! losses are counted exactly, on its link alone.

// Shows DAT-LOCAL (test, full).

use sm2_tests::{
    actor::{Actor, Counted, number},
    control::{self, Qos},
    domain::TempDomain,
    eventually,
    link::{Open, role},
    raw::{RawLink, RawNode},
};

/// How many messages are published at a time: no more than a healthy subscriber has room for, so
/// that no test depends on its speed.
const BATCH: u64 = 32;
const BATCHES: u64 = 12;
const ALL: u64 = BATCH * BATCHES;

/// The process that misbehaves.
enum Culprit {
    /// A node that drives its sockets but never takes a message.
    Idle(Actor),
    /// A node that holds as many messages as it may, and never releases them.
    Hoarder(Actor),
    /// A process that is stopped.
    Stopped(Actor),
    /// A peer that has sent OPEN but never reads its link.
    Deaf(#[allow(dead_code, reason = "held, not used")] (RawNode, RawLink)),
}

/// A publisher, two healthy subscribers, and a culprit.
struct Scene {
    talker: Actor,
    healthy: [Actor; 2],
    culprit: Culprit,
    /// Publications before the culprit fell silent.
    before: u64,
}

const CULPRIT: &str = "culprit";

impl Scene {
    fn new(domain: &TempDomain, reliable: bool, kind: &str) -> Self {
        let socket = domain.socket();
        let mut talker = Actor::start(&socket, "talker");
        talker.tell("pub t t depth=8 reliable_ms=30");
        let healthy = ["healthy-1", "healthy-2"].map(|name| {
            let mut listener = Actor::start(&socket, name);
            listener.tell("sub t t depth=64 reliable");
            listener
        });
        let demand = if reliable { "reliable" } else { "" };
        let start = || {
            let mut actor = Actor::start(&socket, CULPRIT);
            actor.tell(&format!("sub t t depth=4 borrow=3 {demand}"));
            actor
        };
        let (culprit, before) = match kind {
            "idle" => (Culprit::Idle(start()), 0),
            "hoarder" => (Culprit::Hoarder(start()), 3),
            "stopped" => (Culprit::Stopped(start()), 1),
            _ => (deaf(domain, reliable), 0),
        };
        talker.tell("wait t 3");
        let mut scene = Self {
            talker,
            healthy,
            culprit,
            before,
        };
        scene.publish(before, 5_000);
        match &mut scene.culprit {
            Culprit::Hoarder(actor) => drop(actor.tell("hold t 3")),
            Culprit::Stopped(actor) => {
                actor.tell("take t 1");
                actor.stop();
            }
            Culprit::Idle(_) | Culprit::Deaf(_) => {}
        }
        scene
    }

    /// Publishes, and lets the healthy subscribers take everything.
    fn publish(&mut self, count: u64, size: usize) {
        self.talker.tell(&format!("publish t {count} {size}"));
        for listener in &mut self.healthy {
            let taken = listener.tell(&format!("take t {count}"));
            assert!(taken.ends_with("lost=0 damaged=0"), "{taken}");
        }
    }

    fn culprits_link(&mut self) -> Counted {
        self.talker.counted_with("t", CULPRIT)
    }

    /// Asserts that the healthy links delivered everything and dropped nothing.
    fn healthy_got_everything(&mut self) {
        let all = self.before + ALL;
        for name in ["healthy-1", "healthy-2"] {
            let mut link = self.talker.counted_with("t", name);
            eventually("everything to be given back", || {
                link = self.talker.counted_with("t", name);
                link.in_flight == 0
            });
            let counts = (link.offered, link.delivered, link.dropped);
            assert_eq!(counts, (all, all, 0), "{name}");
        }
    }

    /// Lets the culprit behave again: the messages that it receives and those that it counts as
    /// lost add up, and all messages of the link are settled.
    fn forgive(&mut self) {
        let all = self.before + ALL;
        let (Culprit::Idle(actor) | Culprit::Hoarder(actor) | Culprit::Stopped(actor)) =
            &mut self.culprit
        else {
            return;
        };
        actor.resume();
        actor.tell("free t");
        let (mut got, mut lost, mut last) = (self.before, 0, self.before);
        let mut take = |actor: &mut Actor| {
            let taken = actor.tell("drain t");
            if number(&taken, "got") > 0 {
                got += number(&taken, "got");
                lost += number(&taken, "lost");
                last = number(&taken, "last");
            }
            last
        };
        let talker = &mut self.talker;
        eventually("the link to settle", || {
            take(actor);
            talker.counted_with("t", CULPRIT).in_flight == 0
        });
        // The next message reports the losses before it.
        talker.tell("publish t 1 8");
        eventually("the last message", || take(actor) == all + 1);
        assert_eq!(got + lost, all + 1, "{got} received and {lost} lost");
        eventually("the last message to be given back", || {
            let link = self.talker.counted_with("t", CULPRIT);
            link.in_flight == 0 && link.delivered == got && link.dropped == lost
        });
    }
}

fn deaf(domain: &TempDomain, reliable: bool) -> Culprit {
    let node = RawNode::welcomed(&domain.socket(), CULPRIT);
    let qos = if reliable { Qos::RELIABLE } else { Qos::PLAIN };
    node.declare(1, &control::subscriber("t", qos));
    let link = node.linked();
    link.end.send(Open::new(role::RECEIVER, link.id, 6).bytes());
    Culprit::Deaf((node, link))
}

fn play(reliable: bool) {
    for kind in ["idle", "hoarder", "stopped", "deaf"] {
        let domain = TempDomain::new();
        let _manager = domain.manager();
        let mut scene = Scene::new(&domain, reliable, kind);
        for batch in 0..BATCHES {
            // An inline message, a pooled one, and one larger than a socket's buffer.
            scene.publish(BATCH, [100, 5_000, 50_000][batch as usize % 3]);
        }
        scene.healthy_got_everything();
        let link = scene.culprits_link();
        println!("{kind}, reliable {reliable}: {link:?}");
        assert_eq!(link.offered, scene.before + ALL, "{kind}");
        assert!(link.open && link.dropped > 0, "{kind}: {link:?}");
        let reason = if reliable { "no_room" } else { "overwritten" };
        let discarded = if reliable { 0 } else { link.of("discarded") };
        assert_eq!(
            link.of(reason) + discarded,
            link.dropped,
            "{kind}: {link:?}"
        );
        scene.forgive();
    }
}

//= SM2-QOS-001, SM2-QOS-006, SM2-MSG-002, SM2-MSG-005 sys
#[test]
fn a_best_effort_subscriber_that_does_not_play_along_loses_alone() {
    play(false);
}

//= SM2-QOS-002, SM2-QOS-006, SM2-MSG-002, SM2-MSG-005 sys
#[test]
fn a_reliable_subscriber_that_does_not_play_along_loses_alone() {
    play(true);
}

/// A client makes calls and is stopped. Its server still answers the others.
//= SM2-SRV-002 sys
#[test]
fn a_stopped_client_keeps_no_server_from_others() {
    let domain = TempDomain::new();
    let _manager = domain.manager();
    let mut server = Actor::start(&domain.socket(), "server");
    let mut clients = ["stopped", "healthy"].map(|name| Actor::start(&domain.socket(), name));
    server.tell("server s s depth=4 borrow=2");
    for client in &mut clients {
        client.tell("client s s borrow=40");
        client.tell("wait s 1");
    }
    server.tell("wait s 2");
    let [stopped, healthy] = &mut clients;
    for _ in 0..40 {
        stopped.tell("call s 50000");
    }
    stopped.stop();
    // The server has accepted as many requests as it accepts of one client: 6.
    server.say("serve s 100");
    for call in 0..94 {
        healthy.tell(&format!("call s {}", [0, 100, 50_000][call % 3]));
        let reply = healthy.tell("reply s");
        assert!(reply.contains("damaged=0"), "{reply}");
    }
    stopped.resume();
    server.answer();
    server.say("serve s 34");
    for _ in 0..40 {
        let reply = stopped.tell("reply s");
        assert!(reply.contains("damaged=0"), "{reply}");
    }
    assert_eq!(server.answer(), "ok");
}
