//! A peer with more offers, messages and calls than there is room for.

use std::{sync::Arc, time::Duration};

use crate::age::world::World;
use bytes::Bytes;
use sm2_gateway::{
    Counts,
    hub::DEFAULT_SEND_QOS,
    peer::{CallId, Command, Event, Limits, Message},
};
use sm2_io::quic::Congestion;
use sm2_lossy_link::Profile;
use sm2_proto::{
    Name, TypeId,
    gateway::{
        Action, OfferId, Outcome, Pattern, Rule, Rules, Subject, SubjectKind,
        session::{self, ControlCommand},
    },
    limits::OFFERS_MAX,
};

fn world() -> World {
    let mut world = World::new(&link(Duration::from_millis(1)), Congestion::Steady);
    // Both sides have greeted.
    events(&mut world);
    world
}

/// A link without loss, with 1 Gbit/s and this delay.
fn link(delay: Duration) -> Profile {
    Profile {
        rate_bit: 1e9,
        loss_permille: 0,
        delay,
        jitter: Duration::ZERO,
        queue: Duration::from_secs(1),
        pauses: Vec::new(),
        seed: 1,
    }
}

/// Returns the events of the far side within three seconds.
fn events(world: &mut World) -> Vec<Event> {
    let until = world.now.after(Duration::from_secs(3));
    let mut events = Vec::new();
    while world.now < until {
        let step = world.step(until);
        events.extend(
            step.into_iter()
                .filter(|(at, _)| *at == 1)
                .map(|(_, it)| it),
        );
    }
    events
}

fn offer(world: &mut World, offer: u64) {
    offer_with(world, offer, false, 0);
}

fn offer_with(world: &mut World, offer: u64, reliable: bool, latched: u16) {
    let subject = Subject::Topic {
        name: Name::new(&format!("topic{offer}")).unwrap(),
        data: TypeId {
            name: Name::new("bytes").unwrap(),
            hash: 0,
        },
        reliable,
        latched,
    };
    let path = vec![world.hop(0)];
    let command = Command::Offer {
        offer: OfferId(offer),
        subject,
        path,
        qos: DEFAULT_SEND_QOS,
    };
    world.command(0, command);
}

/// Returns the numbers of the received offers, in order of arrival.
fn offered(world: &mut World) -> Vec<u64> {
    let offers = events(world).into_iter().filter_map(|it| match it {
        Event::Session(session::Event::Offered { offer, .. }) => Some(offer.0),
        Event::Ended(reason) => panic!("{reason}"),
        _ => None,
    });
    offers.collect()
}

#[test]
fn an_offer_that_there_was_no_room_for_is_made_later() {
    let mut world = world();
    let max = OFFERS_MAX as u64;
    for number in 1..=max + 4 {
        offer(&mut world, number);
    }
    assert_eq!(offered(&mut world), (1..=max).collect::<Vec<_>>());
    // This offer is withdrawn while it waits, so it is never sent.
    world.command(
        0,
        Command::Control(ControlCommand::Unoffer {
            offer: OfferId(max + 2),
        }),
    );
    assert!(offered(&mut world).is_empty());
    for gone in [7, 9] {
        world.command(
            0,
            Command::Control(ControlCommand::Unoffer {
                offer: OfferId(gone),
            }),
        );
    }
    assert_eq!(offered(&mut world), [max + 1, max + 3]);
    // New offers wait behind the offers that already wait.
    offer(&mut world, max + 5);
    for gone in [1, max + 1] {
        world.command(
            0,
            Command::Control(ControlCommand::Unoffer {
                offer: OfferId(gone),
            }),
        );
    }
    assert_eq!(offered(&mut world), [max + 4, max + 5]);
}

#[test]
fn what_waits_of_an_offer_that_goes_counts_as_withdrawn_of_its_name() {
    let mut world = world();
    offer(&mut world, 1);
    events(&mut world);
    let want = Command::Control(ControlCommand::Want {
        offer: OfferId(1),
        depth: 1,
    });
    world.command(1, want);
    events(&mut world);
    for sequence in 1..=4 {
        let offer = OfferId(1);
        let message = Message {
            sequence,
            published_at: world.now,
            payload: Bytes::from(vec![0; 4 << 20]),
        };
        world.command(0, Command::Message { offer, message });
        // The first message starts here. It is too long to leave before the others come.
        world.step(world.now);
    }
    world.command(
        0,
        Command::Control(ControlCommand::Unoffer { offer: OfferId(1) }),
    );
    let expected = Counts {
        offered: 4,
        superseded: 2,
        withdrawn: 2,
        ..Counts::default()
    };
    let key = (SubjectKind::Topic, Name::new("topic1").unwrap());
    assert_eq!(world.counts(0), (expected, vec![(key, expected)]));
}

/// Makes the far side want topic 1 with a deep queue.
fn deeply_wanted(world: &mut World) {
    offer(world, 1);
    events(world);
    let (offer, depth) = (OfferId(1), 1_024);
    world.command(1, Command::Control(ControlCommand::Want { offer, depth }));
    events(world);
}

/// Messages that follow each other closely go as datagrams, which are not sent again, unless their topic is reliable or
/// latched.
//= SM2-GWM-003 test
#[test]
fn what_must_not_be_lost_goes_on_streams() {
    const SENT: u64 = 300;
    let mut world = World::new(&link(Duration::from_millis(20)), Congestion::Steady);
    events(&mut world);
    for (number, reliable, latched) in [(1, true, 0), (2, false, 10), (3, false, 0)] {
        offer_with(&mut world, number, reliable, latched);
        events(&mut world);
        let (offer, depth) = (OfferId(number), 1_024);
        world.command(1, Command::Control(ControlCommand::Want { offer, depth }));
        events(&mut world);
    }
    world.loss_permille = 100;
    let mut received = [0; 3];
    let mut count = |events: Vec<Event>| {
        for event in events {
            if let Event::Message { offer, .. } = event {
                received[usize::try_from(offer.0).unwrap() - 1] += 1;
            }
        }
    };
    for sequence in 1..=SENT {
        for offer in [1, 2, 3].map(OfferId) {
            let message = Message {
                sequence,
                published_at: world.now,
                payload: Bytes::from_static(b"short"),
            };
            world.command(0, Command::Message { offer, message });
        }
        let until = world.now.after(Duration::from_millis(1));
        while world.now < until {
            let step = world.step(until).into_iter();
            count(step.filter(|(at, _)| *at == 1).map(|(_, it)| it).collect());
        }
    }
    for _ in 0..5 {
        count(events(&mut world));
    }
    let [reliable, latched, other] = received;
    assert_eq!((reliable, latched), (SENT, SENT));
    assert!((SENT / 2..SENT).contains(&other), "{other}");
}

#[test]
fn messages_for_a_peer_take_no_more_memory_than_they_may() {
    let mut world = world();
    deeply_wanted(&mut world);
    let payload = Bytes::from(vec![0; 16 << 20]);
    for sequence in 1..=20 {
        let message = Message {
            sequence,
            published_at: world.now,
            payload: payload.clone(),
        };
        let offer = OfferId(1);
        world.command(0, Command::Message { offer, message });
    }
    // Seven messages fit, with their headers: the newest ones, and the one in flight.
    assert_eq!(Limits::default().memory_bytes, 8 * payload.len() as u64);
    let expected = Counts {
        offered: 20,
        superseded: 13,
        ..Counts::default()
    };
    assert_eq!(world.counts(0).0, expected);
    // Other peers need their parts of the gateway's memory: 64 MiB are left for this one.
    let others = [(); 7].map(|()| world.budgets[0].join());
    assert_eq!(others[0].part_bytes(), 4 * payload.len() as u64);
    world.command(0, Command::Forget { call: CallId(1) });
    let superseded = world.counts(0).0.superseded;
    assert_eq!(superseded, 17, "the three newest stay");
}

/// A payload whose memory is counted.
struct Counted(Vec<u8>, #[expect(dead_code, reason = "counts")] Arc<()>);

impl AsRef<[u8]> for Counted {
    fn as_ref(&self) -> &[u8] {
        &self.0
    }
}

/// On a long link, QUIC holds what the peer has not acknowledged yet: up to 3 MB. This adds to what waits.
#[test]
fn what_waits_and_what_quic_holds_have_one_limit() {
    const PAYLOAD_BYTES: usize = 25_000;
    const TOPICS: u64 = 20;
    let limits = Limits {
        message_bytes: 1 << 18,
        memory_bytes: 1 << 20,
        ..Limits::default()
    };
    let most = limits.memory_bytes as usize / PAYLOAD_BYTES;
    let link = Profile {
        rate_bit: 2.5e8,
        ..link(Duration::from_millis(50))
    };
    let mut world = World::with_limits(&link, Congestion::NewReno, limits);
    events(&mut world);
    for number in 1..=TOPICS {
        offer(&mut world, number);
    }
    events(&mut world);
    for number in 1..=TOPICS {
        let (offer, depth) = (OfferId(number), 1_024);
        world.command(1, Command::Control(ControlCommand::Want { offer, depth }));
    }
    events(&mut world);
    let counted = Arc::new(());
    let held = || Arc::strong_count(&counted) - 1;
    let (mut peak, mut received) = (0, 0);
    // More than the link carries, for 1.6 s.
    for sequence in 1..=2_500 {
        let payload = Counted(vec![0; PAYLOAD_BYTES], Arc::clone(&counted));
        let message = Message {
            sequence,
            published_at: world.now,
            payload: Bytes::from_owner(payload),
        };
        let offer = OfferId(1 + sequence % TOPICS);
        world.command(0, Command::Message { offer, message });
        let until = world.now.after(Duration::from_micros(640));
        while world.now < until {
            let step = world.step(until).into_iter();
            received += step
                .filter(|(_, it)| matches!(it, Event::Message { .. }))
                .count();
            peak = peak.max(held());
        }
    }
    println!("{peak} payloads of {most}; {received} messages have arrived");
    assert!(peak <= most, "{peak} payloads, and {most} may be held");
    // The memory is used, and what it holds arrives.
    assert!(peak > most / 2, "{peak} payloads, and {most} may be held");
    assert!(received > 100, "{received} messages");
    let rest = events(&mut world);
    assert!(rest.iter().any(|it| matches!(it, Event::Message { .. })));
    assert_eq!(held(), 0, "all are acknowledged");
}

#[test]
fn requests_for_a_peer_take_no_more_memory_than_they_may() {
    let mut world = world();
    let name = Name::new("echo").unwrap();
    let bytes = TypeId {
        name: Name::new("bytes").unwrap(),
        hash: 0,
    };
    let command = Command::Offer {
        offer: OfferId(1),
        subject: Subject::Service {
            name,
            request: bytes.clone(),
            reply: bytes,
        },
        path: vec![world.hop(0)],
        qos: DEFAULT_SEND_QOS,
    };
    world.command(0, command);
    events(&mut world);
    let (offer, depth) = (OfferId(1), 1);
    world.command(1, Command::Control(ControlCommand::Want { offer, depth }));
    events(&mut world);
    let payload = Bytes::from(vec![0; 50 << 20]);
    for call in 1..=3 {
        let command = Command::Call {
            call: CallId(call),
            offer,
            deadline: None,
            payload: payload.clone(),
        };
        world.command(1, command);
    }
    let now = world.now;
    let replies = world.step(now).into_iter().filter_map(|it| match it {
        (1, Event::Reply { call, outcome, .. }) => Some((call.0, outcome)),
        _ => None,
    });
    assert_eq!(replies.collect::<Vec<_>>(), [(3, Outcome::Unreachable)]);
    assert_eq!(world.counts(1).0.lost, 1);
}

//= SM2-GWR-004 test
#[test]
fn what_other_rules_deny_is_not_sent_before_its_offer_is_withdrawn() {
    let mut world = world();
    for number in [1, 2] {
        offer(&mut world, number);
        events(&mut world);
        let (offer, depth) = (OfferId(number), 4);
        world.command(1, Command::Control(ControlCommand::Want { offer, depth }));
        events(&mut world);
    }
    let send = |world: &mut World, offer, sequence, len| {
        let message = Message {
            sequence,
            published_at: world.now,
            payload: Bytes::from(vec![0; len]),
        };
        let offer = OfferId(offer);
        world.command(0, Command::Message { offer, message });
        // A message without predecessor starts here. A long one does not leave before the others come.
        world.step(world.now);
    };
    let received = |world: &mut World| {
        let events = events(world).into_iter();
        let messages = events.filter_map(|it| match it {
            Event::Message { offer, message } => Some((offer.0, message.sequence)),
            _ => None,
        });
        messages.collect::<Vec<_>>()
    };
    for sequence in 1..=3 {
        send(&mut world, 1, sequence, 4 << 20);
    }
    send(&mut world, 2, 1, 4 << 20);
    let rule = |action, names| Rule {
        action,
        kind: None,
        names: Pattern::new(names).unwrap(),
        direction: None,
        peers: None,
    };
    let rules = vec![rule(Action::Deny, "topic1"), rule(Action::Allow, "**")];
    world.command(0, Command::Rules(Some(Arc::new(Rules(rules)))));
    send(&mut world, 1, 4, 10);
    assert_eq!(received(&mut world), [(2, 1)]);
    let expected = Counts {
        offered: 4,
        withdrawn: 4,
        ..Counts::default()
    };
    assert_eq!(world.counts(0).1[0].1, expected);
    // The next rules allow the topic again, and its offer was not withdrawn in between.
    world.command(0, Command::Rules(None));
    send(&mut world, 1, 5, 10);
    assert_eq!(received(&mut world), [(1, 5)]);
}

//= SM2-GWR-004 test
#[test]
fn a_request_that_other_rules_deny_is_abandoned() {
    let mut world = world();
    let bytes = TypeId {
        name: Name::new("bytes").unwrap(),
        hash: 0,
    };
    let command = Command::Offer {
        offer: OfferId(1),
        subject: Subject::Service {
            name: Name::new("echo").unwrap(),
            request: bytes.clone(),
            reply: bytes,
        },
        path: vec![world.hop(0)],
        qos: DEFAULT_SEND_QOS,
    };
    world.command(0, command);
    events(&mut world);
    let (offer, depth) = (OfferId(1), 1);
    world.command(1, Command::Control(ControlCommand::Want { offer, depth }));
    events(&mut world);
    let call = Command::Call {
        call: CallId(1),
        offer,
        deadline: None,
        payload: Bytes::from(vec![0; 4 << 20]),
    };
    world.command(1, call);
    world.step(world.now);
    world.command(1, Command::Rules(Some(Arc::default())));
    let until = world.now.after(Duration::from_secs(3));
    let mut ends = Vec::new();
    while world.now < until {
        ends.extend(world.step(until).into_iter().filter_map(|it| match it {
            (1, Event::Reply { call, outcome, .. }) => Some((call.0, outcome)),
            (0, Event::Request { .. }) => panic!("the request has arrived"),
            _ => None,
        }));
    }
    assert_eq!(ends, [(1, Outcome::Unreachable)]);
}
