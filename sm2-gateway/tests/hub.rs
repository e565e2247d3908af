//! The hub alone: inputs, and the outputs that they lead to.

// Shows GW-EPOCH, GW-NOLOOP, GW-AUTH, GW-LATCH (test).

mod calls;
mod epochs;
mod latched;
mod reload;

use bytes::Bytes;
use sm2_gateway::{
    hub::{Denial, Hub, Input, LocalCommand, LocalEvent, NoRoom, Output, Policy},
    peer::{Command, ConnectionId, Event, Message},
};
use sm2_proto::{
    Instant, Machine, Name, TypeId,
    gateway::{
        Action, AskId, Direction, GatewayId, Hop, OfferId, Pattern, PeerFarewell, Rule, Rules,
        Subject, SubjectKind, Verdict,
        session::{self, ControlCommand, Initiator},
    },
};

const NOW: Instant = Instant(1_000_000_000);

fn hop(number: u8) -> Hop {
    Hop {
        gateway: GatewayId([number; 32]),
        epoch: u64::from(number),
    }
}

fn name(text: &str) -> Name {
    Name::new(text).unwrap()
}

fn bytes() -> TypeId {
    TypeId {
        name: name("bytes"),
        hash: 0,
    }
}

fn topic(text: &str) -> Subject {
    Subject::Topic {
        name: name(text),
        data: bytes(),
        reliable: false,
        latched: 0,
    }
}

fn service(text: &str) -> Subject {
    Subject::Service {
        name: name(text),
        request: bytes(),
        reply: bytes(),
    }
}

fn rule(action: Action, names: &str) -> Rule {
    Rule {
        action,
        kind: None,
        names: Pattern::new(names).unwrap(),
        direction: None,
        peers: None,
    }
}

fn policy(rules: Vec<Rule>) -> Policy {
    Policy {
        rules: Rules(rules),
        send_qos: Vec::new(),
    }
}

/// Gateway 5, whose rules allow everything.
fn hub() -> Hub {
    Hub::new(hop(5), policy(vec![rule(Action::Allow, "**")]))
}

fn outputs(hub: &mut Hub) -> Vec<Output> {
    std::iter::from_fn(|| hub.poll()).collect()
}

fn tell(hub: &mut Hub, connection: u64, event: Event) -> Vec<Output> {
    let Ok(()) = hub.handle(
        NOW,
        Input::Peer {
            connection: ConnectionId(connection),
            initiator: Initiator::Peer,
            event,
        },
    );
    outputs(hub)
}

fn local(hub: &mut Hub, event: LocalEvent) -> Vec<Output> {
    let Ok(()) = hub.handle(NOW, Input::Local(event));
    outputs(hub)
}

fn greet(hub: &mut Hub, connection: u64, peer: u8, epoch: u64) -> Vec<Output> {
    let event = Event::Session(session::Event::Greeted {
        peer: hop(peer).gateway,
        epoch,
        name: name("peer"),
    });
    tell(hub, connection, event)
}

fn offered(hub: &mut Hub, connection: u64, offer: u64, subject: Subject, path: &[u8]) {
    let path = path.iter().map(|it| hop(*it)).collect();
    offered_by(hub, connection, offer, subject, path);
}

fn offered_by(hub: &mut Hub, connection: u64, offer: u64, subject: Subject, path: Vec<Hop>) {
    let offered = Event::Session(session::Event::Offered {
        offer: OfferId(offer),
        subject,
        path,
    });
    tell(hub, connection, offered);
}

fn message(offer: u64, sequence: u64) -> Event {
    let message = Message {
        sequence,
        published_at: NOW,
        payload: Bytes::from_static(b"x"),
    };
    let offer = OfferId(offer);
    Event::Message { offer, message }
}

fn wanted(offer: u64, depth: u16) -> Event {
    let offer = OfferId(offer);
    Event::Session(session::Event::Wanted { offer, depth })
}

fn gone(offer: u64) -> Event {
    let offer = OfferId(offer);
    Event::Session(session::Event::Gone { offer })
}

fn publications(outputs: &[Output]) -> usize {
    let is_it = |it: &&Output| matches!(it, Output::Local(LocalCommand::Publish { .. }));
    outputs.iter().filter(is_it).count()
}

fn closed(outputs: &[Output]) -> Vec<(u64, u16)> {
    let of = |it: &Output| match it {
        Output::Peer {
            connection,
            command: Command::Close(code),
        } => Some((connection.0, code.0)),
        _ => None,
    };
    outputs.iter().filter_map(of).collect()
}

//= SM2-GWC-004 test
#[test]
fn of_two_connections_with_one_peer_one_stays() {
    let (duplicate, stale) = (
        PeerFarewell::Duplicate.code().0,
        PeerFarewell::Stale.code().0,
    );
    // Peer 9 has the greater id: with equal epochs, a connection opened by this gateway would stay.
    // The peer opened both of these.
    for (first, second, expected) in [
        (7, 7, (2, duplicate)),
        (7, 8, (1, stale)),
        (8, 7, (2, stale)),
    ] {
        let mut hub = hub();
        greet(&mut hub, 1, 9, first);
        let said = greet(&mut hub, 2, 9, second);
        assert_eq!(closed(&said), [expected], "{first}, {second}");
    }
    // Peer 3 has the smaller id: with equal epochs, the connection that the peer opened stays.
    let mut hub = hub();
    let event = Event::Session(session::Event::Greeted {
        peer: hop(3).gateway,
        epoch: 7,
        name: name("peer"),
    });
    let Ok(()) = hub.handle(
        NOW,
        Input::Peer {
            connection: ConnectionId(1),
            initiator: Initiator::ThisGateway,
            event,
        },
    );
    outputs(&mut hub);
    assert_eq!(closed(&greet(&mut hub, 2, 3, 7)), [(1, duplicate)]);
}

//= SM2-GWC-004 test
#[test]
fn what_was_known_of_a_peer_is_forgotten_with_its_connection() {
    let mut hub = hub();
    greet(&mut hub, 1, 9, 7);
    offered(&mut hub, 1, 1, topic("scan"), &[9]);
    let said = greet(&mut hub, 2, 9, 8);
    let hidden = |it: &Output| matches!(it, Output::Local(LocalCommand::WithdrawProxy { .. }));
    assert!(said.iter().any(hidden), "{said:?}");
    let lost = said.iter().any(|it| matches!(it, Output::Lost { .. }));
    assert!(lost, "{said:?}");
    // Later events of the old connection are ignored.
    assert!(tell(&mut hub, 1, message(1, 1)).is_empty());
}

//= SM2-GWO-005 test
#[test]
fn questions_have_answers() {
    let rules = vec![rule(Action::Deny, "secret/**"), rule(Action::Allow, "**")];
    let mut hub = Hub::new(hop(5), policy(rules));
    greet(&mut hub, 1, 9, 7);
    for there in ["scan", "secret/scan"] {
        let subject = topic(there);
        let present = true;
        local(&mut hub, LocalEvent::Present { subject, present });
    }
    let mut ask = |kind, text| {
        let event = Event::Session(session::Event::Asked {
            ask: AskId(1),
            kind,
            name: name(text),
        });
        match tell(&mut hub, 1, event).as_slice() {
            [
                Output::Peer {
                    command:
                        Command::Control(ControlCommand::Answer {
                            ask: AskId(1),
                            verdict,
                        }),
                    ..
                },
            ] => *verdict,
            other => panic!("{other:?}"),
        }
    };
    assert_eq!(ask(SubjectKind::Topic, "scan"), Verdict::Offered);
    assert_eq!(ask(SubjectKind::Service, "scan"), Verdict::Absent);
    assert_eq!(ask(SubjectKind::Topic, "map"), Verdict::Absent);
    assert_eq!(ask(SubjectKind::Topic, "secret/scan"), Verdict::Denied);
    assert_eq!(ask(SubjectKind::Topic, "secret/map"), Verdict::Denied);
}

/// Gateway 9 offers a topic and gateway 3 wants it; both are peers of gateway 5.
fn between() -> Hub {
    let mut hub = hub();
    greet(&mut hub, 1, 9, 9);
    greet(&mut hub, 2, 3, 3);
    offered(&mut hub, 1, 4, topic("scan"), &[9]);
    tell(&mut hub, 2, wanted(1, 1));
    hub
}

//= SM2-GWM-007 test
#[test]
fn a_message_is_passed_on_as_it_came() {
    let mut hub = between();
    let came = Message {
        sequence: 17,
        published_at: Instant(NOW.0 - 250_000_000),
        payload: Bytes::from_static(b"x"),
    };
    let event = Event::Message {
        offer: OfferId(4),
        message: came.clone(),
    };
    let said = tell(&mut hub, 1, event);
    let passed = said.iter().find_map(|it| match it {
        Output::Peer {
            connection: ConnectionId(2),
            command:
                Command::Message {
                    offer: OfferId(1),
                    message,
                },
        } => Some(message),
        _ => None,
    });
    assert_eq!(passed, Some(&came), "{said:?}");
    // A message is not sent back to the peer that it came from.
    let back = |it: &Output| {
        matches!(
            it,
            Output::Peer {
                connection: ConnectionId(1),
                ..
            }
        )
    };
    assert!(!said.iter().any(back), "{said:?}");
}

//= SM2-GWM-008 test
#[test]
fn a_message_is_taken_once() {
    let mut hub = between();
    let mut taken = |sequence| publications(&tell(&mut hub, 1, message(4, sequence)));
    assert_eq!([1, 1, 3, 2, 3, 4].map(&mut taken), [1, 0, 1, 0, 0, 1]);
    // After a restart of its process, an origin numbers its messages from 1 again.
    tell(&mut hub, 1, gone(4));
    let path = vec![Hop {
        epoch: 10,
        ..hop(9)
    }];
    offered_by(&mut hub, 1, 5, topic("scan"), path);
    tell(&mut hub, 2, wanted(2, 1));
    assert_eq!(publications(&tell(&mut hub, 1, message(5, 1))), 1);
}

/// A peer can invent origins. The hub remembers only a bounded number of those that are no longer
/// offered.
#[test]
fn what_was_seen_is_forgotten_in_the_end() {
    /// More than are remembered.
    const ROUNDS: u64 = if cfg!(feature = "slow") {
        40_000
    } else {
        17_000
    };
    let mut hub = between();
    for round in 0..ROUNDS {
        let [first, second, ..] = round.to_le_bytes();
        let mut origin = hop(100);
        origin.gateway.0[..2].copy_from_slice(&[first, second]);
        let (offer, path) = (5 + round, vec![origin, hop(9)]);
        offered_by(&mut hub, 1, offer, topic("scan"), path);
        tell(&mut hub, 2, wanted(2 + round, 1));
        let count = publications(&tell(&mut hub, 1, message(offer, 1)));
        assert_eq!(count, 1, "{round}");
        tell(&mut hub, 1, gone(offer));
    }
    assert!(hub.remembered() <= 16_384 + 1, "{}", hub.remembered());
}

#[test]
fn what_rules_deny_is_told_with_the_rule() {
    let mut hub = Hub::new(
        hop(5),
        policy(vec![
            rule(Action::Deny, "secret/*"),
            Rule {
                direction: Some(Direction::Out),
                ..rule(Action::Allow, "**")
            },
        ]),
    );
    for text in ["secret/a", "open"] {
        let (subject, present) = (topic(text), true);
        local(&mut hub, LocalEvent::Present { subject, present });
    }
    greet(&mut hub, 1, 1, 1);
    offered(&mut hub, 1, 1, topic("theirs"), &[1]);
    let denial = |text, direction, rule| Denial {
        subject: topic(text),
        direction,
        rule,
    };
    let denied = [
        denial("secret/a", Direction::Out, Some(0)),
        denial("theirs", Direction::In, None),
    ];
    assert_eq!(hub.peers()[0].denied, denied);
    let Ok(()) = hub.handle(NOW, Input::Policy(policy(vec![rule(Action::Allow, "**")])));
    assert_eq!(hub.peers()[0].denied, []);
}

#[test]
fn what_was_left_out_is_counted_only_while_it_was_wanted() {
    let mut hub = hub();
    greet(&mut hub, 1, 1, 1);
    offered(&mut hub, 1, 1, topic("scan"), &[1]);
    let taken = |taken| LocalEvent::Taken {
        subject: topic("scan"),
        origin: hop(1).gateway,
        taken,
    };
    local(&mut hub, taken(Some(4)));
    let skipped = |hub: &Hub| hub.peers()[0].counts.skipped;
    // Messages before the first received one do not count as lost.
    tell(&mut hub, 1, message(1, 10));
    tell(&mut hub, 1, message(1, 11));
    assert_eq!(skipped(&hub), 0);
    tell(&mut hub, 1, message(1, 14));
    assert_eq!(skipped(&hub), 2);
    // This message arrived too late to be passed on.
    tell(&mut hub, 1, message(1, 13));
    assert_eq!(skipped(&hub), 2);
    local(&mut hub, taken(None));
    local(&mut hub, taken(Some(4)));
    tell(&mut hub, 1, message(1, 100));
    assert_eq!(skipped(&hub), 2);
    tell(&mut hub, 1, message(1, u64::MAX));
    assert_eq!(skipped(&hub), 2 + (u64::MAX - 101));
    let by_name = &hub.peers()[0].counts_by_name;
    assert_eq!(by_name[0].0, (SubjectKind::Topic, name("scan")));
    assert_eq!(by_name[0].1, hub.peers()[0].counts);
}

#[test]
fn messages_without_room_are_lost_messages_of_their_topic() {
    let mut hub = hub();
    greet(&mut hub, 1, 1, 1);
    greet(&mut hub, 2, 2, 1);
    offered(&mut hub, 1, 1, topic("scan"), &[1]);
    let out = local(
        &mut hub,
        LocalEvent::Taken {
            subject: topic("scan"),
            origin: hop(1).gateway,
            taken: Some(1),
        },
    );
    assert!(!out.is_empty());
    let no_room = |hub: &mut Hub, what| {
        let Ok(()) = hub.handle(NOW, Input::NoRoom(what));
        assert!(outputs(hub).is_empty());
    };
    no_room(
        &mut hub,
        NoRoom::ForDomain {
            subject: topic("scan"),
            origin: hop(1).gateway,
        },
    );
    // The queue had room, but the message could not be published.
    let unpublished = LocalEvent::Unpublished {
        subject: topic("scan"),
        origin: hop(1).gateway,
    };
    assert!(local(&mut hub, unpublished).is_empty());
    // The hub's own offer to the other peer has the number 1 too.
    for (connection, offer) in [(2, 1), (2, 1), (2, 9), (7, 1)] {
        no_room(
            &mut hub,
            NoRoom::ForPeer {
                connection: ConnectionId(connection),
                offer: OfferId(offer),
            },
        );
    }
    let peers = hub.peers();
    assert_eq!(
        (peers[0].counts.lost, peers[0].counts_by_name[0].1.lost),
        (2, 2)
    );
    assert_eq!(
        (peers[1].counts.lost, peers[1].counts_by_name[0].1.lost),
        (3, 2)
    );
}
