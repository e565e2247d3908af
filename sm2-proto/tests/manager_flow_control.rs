//! Flow control for LINK frames: how many a session is sent ahead of its socket, which links wait,
//! and the cost of one input. The cost is counted in outputs and pairs, not in time.

// Shows MGR-PACE (test), bound: 11 histories, counted, not timed.

use crate::support;
use std::collections::{BTreeMap, BTreeSet};

use crate::support::{
    bench::{Bench, EPOCH, Event, UNLIMITED, resuming, seen_by, unlink, unlinked, withdraw},
    contracts::{client, data, scan, server, subscriber},
};
use sm2_proto::{
    Datagram, InterfaceId, LinkId, Machine, NodeId,
    control::{Limit, Limits, ToManager, ToNode, encode_to_manager},
    manager::{Cause, Input, Output},
    violation,
};

const AHEAD: usize = 4;
const LIMITS: Limits = UNLIMITED
    .with(Limit::LinksInFlight, AHEAD as u32)
    .with(Limit::WorkPerTurn, 2_048);

/// All outputs of the deferred work, while these sessions read everything that is sent to them.
fn all_outputs(bench: &mut Bench, readers: &[NodeId]) -> Vec<Event> {
    let mut events = Vec::new();
    loop {
        for &session in readers {
            if bench.manager.awaits_room(session) {
                assert_eq!(bench.input(Input::Drained { session }), []);
            }
        }
        if bench.manager.deadline() != Some(bench.now) {
            return events;
        }
        let some = bench.input(Input::Tick);
        assert!(some.len() <= 2 * AHEAD, "{} outputs", some.len());
        events.extend(some);
    }
}

fn links(events: &[Event]) -> Vec<LinkId> {
    let links = events.iter().map(|event| match event {
        Event::Linked(link, _) => *link,
        other => panic!("{other:?} is no link"),
    });
    links.collect()
}

/// A session with this many publishers of one topic.
fn offering(bench: &mut Bench, text: &str, publishers: u64) -> NodeId {
    let node = bench.node(1, text);
    for interface in 1..=publishers {
        assert_eq!(bench.declared(node, interface, &scan()), []);
    }
    node
}

//= SM2-LNK-006, SM2-IFC-002, SM2-MAT-002 test
#[test]
fn links_wait_until_others_are_read() {
    let mut bench = Bench::new(LIMITS);
    let a = offering(&mut bench, "a", 10);
    let b = bench.node(1, "b");
    let at_once = bench.declared(b, 1, &subscriber("scan", None));
    assert_eq!(at_once.len(), AHEAD, "DECLARED says so, too");
    assert_eq!(bench.manager.links(), 10, "the others are made as well");
    assert_eq!(
        bench.manager.deadline(),
        None,
        "nothing to do before somebody reads"
    );
    assert!(bench.manager.awaits_room(a) && bench.manager.awaits_room(b));
    assert_eq!(
        all_outputs(&mut bench, &[b]),
        [],
        "the other end has not read"
    );
    let mut all = at_once;
    all.extend(links(&all_outputs(&mut bench, &[a, b])));
    let serials: Vec<u64> = all.iter().map(|link| link.serial).collect();
    assert_eq!(
        serials,
        (1..=10).collect::<Vec<_>>(),
        "the oldest first, each once"
    );
}

//= SM2-LNK-006 test
#[test]
fn a_session_that_does_not_read_holds_up_no_other() {
    let mut bench = Bench::new(LIMITS);
    let deaf = offering(&mut bench, "deaf", 10);
    let fine = offering(&mut bench, "fine", 10);
    let c = bench.node(1, "c");
    let mut events = bench.declare(c, 1, &subscriber("scan", None));
    events.extend(all_outputs(&mut bench, &[c, fine]));
    let told = |node| {
        let frames = seen_by(&events, node);
        frames
            .iter()
            .filter(|it| matches!(it, ToNode::Link { .. }))
            .count()
    };
    assert_eq!([told(deaf), told(fine), told(c)], [AHEAD, 10, 10 + AHEAD]);
}

/// A session that never reads costs the Manager no more than the LINKs in flight and the ends of
/// its links, whatever other nodes do.
//= SM2-LNK-006 test
#[test]
fn no_session_fills_the_queue_of_another() {
    let mut bench = Bench::new(LIMITS);
    let deaf = bench.node(1, "deaf");
    bench.declared(deaf, 1, &scan());
    let hostile = bench.node(1, "hostile");
    let mut frames = Vec::new();
    for round in 1..=1_000 {
        let mut events = bench.declare(hostile, round, &subscriber("scan", None));
        events.extend(bench.withdraw(hostile, round));
        events.extend(all_outputs(&mut bench, &[hostile]));
        frames.extend(seen_by(&events, deaf));
    }
    assert_eq!(frames.len(), 2 * AHEAD, "{frames:?}");
    assert_eq!(bench.manager.links(), 0);
}

/// The same for a session under the default limits, in bytes: the Manager buffers at most 1 MiB.
//= SM2-LNK-006, SM2-TRN-008 test
#[test]
fn an_honest_session_is_not_made_to_stall() {
    const QUEUE_BYTES: usize = 1 << 20;
    /// The greatest overhead of a frame besides its bytes.
    const EACH: usize = 64;
    let mut bench = Bench::new(Limits::default());
    let long = |prefix: char| format!("{prefix}{}", "x".repeat(254));
    let topic = long('t');
    let kind = data(&long('k'));
    let victim = bench.node(1, &long('v'));
    let wanted = subscriber(&topic, Some(&kind));
    bench.declared(victim, 1, &wanted);
    let offer = support::contracts::publisher(&topic, &kind);
    let mut bytes = 0;
    let mut hear = |bench: &mut Bench, session, frame: &ToManager| {
        let frame = encode_to_manager(frame);
        let datagram = Datagram::new(&frame);
        let input = Input::Datagram { session, datagram };
        bench.manager.handle(bench.now, input).expect("a frame");
        while let Some(output) = bench.manager.poll() {
            let frames: Vec<_> = match output {
                Output::Send { session, frame } => vec![(session, frame)],
                Output::Link { ends, .. } => ends.into(),
                _ => Vec::new(),
            };
            let own = frames.iter().filter(|(session, _)| *session == victim);
            bytes += own.map(|(_, frame)| frame.len() + EACH).sum::<usize>();
        }
    };
    for hostile in 0..9 {
        let node = bench.node(1, &format!("h{hostile}{}", "y".repeat(250)));
        for turn in 0..2 {
            for interface in 1..=1_000 {
                let declare = ToManager::Declare {
                    interface: InterfaceId(turn * 1_000 + interface),
                    contract: offer.clone(),
                };
                hear(&mut bench, node, &declare);
            }
            for interface in 1..=1_000 {
                hear(&mut bench, node, &withdraw(turn * 1_000 + interface));
            }
        }
    }
    assert!(bytes > 0 && bytes < QUEUE_BYTES, "{bytes} bytes");
}

//= SM2-LNK-006, SM2-LNK-003 test
#[test]
fn links_that_end_before_are_never_named() {
    let mut bench = Bench::new(LIMITS);
    let a = offering(&mut bench, "a", 6);
    let b = bench.node(1, "b");
    bench.declared(b, 1, &subscriber("scan", None));
    let events = bench.withdraw(a, 5);
    assert_eq!(seen_by(&events, b), [], "{events:?}");
    assert_eq!(bench.manager.links(), 5);
    // One of the two is gone. The other one is told as soon as its session has room.
    assert_eq!(
        links(&all_outputs(&mut bench, &[a, b])),
        [LinkId {
            epoch: EPOCH,
            serial: 6
        }]
    );
    let gone = bench.close(a);
    let told = seen_by(&gone, b);
    assert_eq!(told.len(), 5, "{told:?}");
}

//= SM2-LNK-006, SM2-LNK-003 test
#[test]
fn nobody_knows_a_link_that_it_was_not_told_of() {
    let mut bench = Bench::new(LIMITS);
    offering(&mut bench, "a", 6);
    let b = bench.node(1, "b");
    bench.declared(b, 1, &subscriber("scan", None));
    let link = LinkId {
        epoch: EPOCH,
        serial: 6,
    };
    let events = bench.send(b, &unlinked(1, link));
    let cause = Cause::Violation(violation!(UnknownLink, "SM2-LNK-003"));
    assert!(
        matches!(events.last(), Some(Event::HungUp(node, _, it)) if *node == b && *it == cause),
        "{events:?}"
    );
    assert_eq!(bench.manager.links(), 0);
}

/// Without descriptors no LINK is sent, so no frame has to be read before the others.
//= SM2-LNK-006, SM2-IFC-002 test
#[test]
fn links_that_fail_leave_their_room_to_others() {
    let mut bench = Bench::new(LIMITS);
    offering(&mut bench, "a", 10);
    let b = bench.node(1, "b");
    let failed = bench.declared(b, 1, &subscriber("scan", None));
    for link in failed {
        assert_eq!(bench.input(Input::LinkFailed { link }), []);
    }
    let next = bench.input(Input::Tick);
    assert_eq!(links(&next).first().map(|it| it.serial), Some(5));
    assert_eq!(bench.manager.links(), 6);
}

/// The first call goes to the server that has connected, however slow the other servers are.
//= SM2-LNK-006 test
#[test]
fn matches_counts_only_what_follows_at_once() {
    let mut bench = Bench::new(LIMITS);
    let slow = bench.node(1, "slow");
    let plan = || client("plan", None);
    bench.declared(slow, 1, &server("plan", &data("Q"), &data("A")));
    for caller in 0..6 {
        let node = bench.node(1, &format!("caller{caller}"));
        let at_once = bench.declared(node, 1, &plan()).len();
        assert_eq!(at_once, usize::from(caller < AHEAD), "caller {caller}");
    }
}

/// One CLAIMED of a session with this many subscribers. Each of them matches this many publishers.
//= SM2-RES-007, SM2-LNK-006 test
#[test]
fn one_claimed_is_settled_in_parts() {
    const SUBSCRIBERS: u64 = 200;
    const PUBLISHERS: u64 = 100;
    const WORK_PER_TURN: u32 = 256;
    const LINKS: u64 = 300;
    let limits = LIMITS
        .with(Limit::InterfacesPerSession, 1_024)
        .with(Limit::WorkPerTurn, WORK_PER_TURN)
        .with(Limit::LinksPerSession, 300);
    let mut bench = Bench::new(limits);
    let a = offering(&mut bench, "a", PUBLISHERS);
    let other = offering(&mut bench, "other", PUBLISHERS);
    let b = bench.connect(1);
    bench.send(b, &resuming("b"));
    for interface in 1..=SUBSCRIBERS {
        assert_eq!(bench.declared(b, interface, &subscriber("scan", None)), []);
    }
    let mut events = bench.send(b, &ToManager::Claimed);
    let mut ticks = 0_u64;
    let mut others = 0;
    while bench.manager.deadline() == Some(bench.now) {
        assert!(events.len() <= 2 * AHEAD, "{} outputs", events.len());
        // An input that arrives in between is handled in between.
        let probe = bench.node(1, &format!("probe{ticks}"));
        let served = bench.declare(probe, 1, &subscriber("map", None));
        assert!(matches!(
            served[..],
            [Event::Sent(_, ToNode::Declared { .. })]
        ));
        bench.close(probe);
        others += 1;
        events = bench.input(Input::Tick);
        ticks += 1;
    }
    let pairs = SUBSCRIBERS * PUBLISHERS * 2;
    let per_turn = u64::from(WORK_PER_TURN);
    // A comparison costs 1, a link 64, and a pair that the quota does not allow 4.
    let work = 5 * pairs + 64 * LINKS;
    assert!(
        ticks >= pairs / per_turn - 1,
        "{ticks} turns for {pairs} pairs"
    );
    assert!(
        ticks <= work / per_turn + SUBSCRIBERS,
        "{ticks} turns for {pairs} pairs"
    );
    assert_eq!(others, ticks);
    assert_eq!(bench.manager.links(), 300);
    all_outputs(&mut bench, &[a, other, b]);
}

/// While a session is settled, its interfaces are like any other's. One pair is compared for each
/// input.
//= SM2-RES-007, SM2-LNK-009, SM2-MAT-002 test
#[test]
fn what_happens_while_a_session_is_settled() {
    let limits = UNLIMITED
        .with(Limit::LinksInFlight, 100)
        .with(Limit::WorkPerTurn, 1);
    let mut bench = Bench::new(limits);
    let a = offering(&mut bench, "a", 3);
    let b = bench.connect(1);
    bench.send(b, &resuming("b"));
    for interface in 1..=3 {
        bench.declared(b, interface, &subscriber("scan", None));
    }
    let mut rest = bench.send(b, &ToManager::Claimed);
    assert_eq!(rest.len(), 1, "one pair was looked at");
    // A new publisher is linked with the first subscriber. This link ends, and is not made again.
    let new = bench.declare(a, 4, &scan());
    let (declared, new) = new.split_first().expect("an answer");
    assert!(matches!(
        declared,
        Event::Sent(_, ToNode::Declared { matches: 1, .. })
    ));
    rest.extend_from_slice(new);
    // The Manager first links the new publisher with the other subscribers.
    let mut events = bench.unlinked(a, 4, links(new)[0]);
    let ended = events.split_off(2);
    assert_eq!(seen_by(&ended, b), [unlink(1, links(new)[0], 5)]);
    rest.extend(events);
    // One publisher goes.
    assert_eq!(bench.withdraw(a, 2).len(), 1, "WITHDRAWN");
    while bench.manager.deadline() == Some(bench.now) {
        let some = bench.input(Input::Tick);
        assert!(some.len() <= 1, "{some:?}");
        rest.extend(some);
    }
    let mut pairs: BTreeMap<(InterfaceId, InterfaceId), usize> = BTreeMap::new();
    for event in &rest {
        let Event::Linked(
            _,
            [
                (first, ToNode::Link { interface: one, .. }),
                (
                    _,
                    ToNode::Link {
                        interface: other, ..
                    },
                ),
            ],
        ) = event
        else {
            panic!("{event:?} is no link");
        };
        let pair = if *first == b {
            (*one, *other)
        } else {
            (*other, *one)
        };
        *pairs.entry(pair).or_default() += 1;
    }
    let each = |b| [1, 3, 4].map(|a| (InterfaceId(b), InterfaceId(a)));
    let expected: BTreeSet<_> = [1, 2, 3].into_iter().flat_map(each).collect();
    assert_eq!(pairs.keys().copied().collect::<BTreeSet<_>>(), expected);
    assert!(pairs.values().all(|&times| times == 1));
}

/// Sessions are settled in turn, so none waits until another one is finished.
//= SM2-RES-007 test
#[test]
fn sessions_are_settled_in_turns() {
    let limits = UNLIMITED
        .with(Limit::LinksInFlight, 1_000)
        .with(Limit::WorkPerTurn, 10 * 65);
    let mut bench = Bench::new(limits);
    offering(&mut bench, "a", 50);
    let mut both = [NodeId(0); 2];
    for (at, node) in both.iter_mut().enumerate() {
        *node = bench.connect(1);
        bench.send(*node, &resuming(&format!("back{at}")));
        for interface in 1..=4 {
            bench.declared(*node, interface, &subscriber("scan", None));
        }
    }
    let mut linked = [0_usize; 2];
    let mut note = |events: Vec<Event>, node: Option<NodeId>| {
        let to = |at: usize| {
            events
                .iter()
                .any(|it| !seen_by(std::slice::from_ref(it), both[at]).is_empty())
        };
        let served = [to(0), to(1)];
        assert!(node.is_none() || served.iter().filter(|it| **it).count() <= 1);
        for (count, served) in linked.iter_mut().zip(served) {
            *count += usize::from(served);
        }
        assert!(linked[0].abs_diff(linked[1]) <= 1, "{linked:?}");
    };
    for node in both {
        let events = bench.send(node, &ToManager::Claimed);
        note(events, Some(node));
    }
    while bench.manager.deadline() == Some(bench.now) {
        let events = bench.input(Input::Tick);
        note(events, None);
    }
    assert_eq!(bench.manager.links(), 2 * 4 * 50);
}
