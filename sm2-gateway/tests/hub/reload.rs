//! Other rules for more routes than one piece has.

use std::{collections::BTreeSet, num::NonZeroU64};

use bytes::Bytes;
use sm2_gateway::{
    hub::{DEFAULT_SEND_QOS, Hub, Input, LocalCommand, LocalEvent, Output, Policy, RequestId},
    peer::{CallId, Command, ConnectionId, Event, PeerCall, Reason},
};
use sm2_proto::{
    Machine,
    gateway::{
        Action, Direction, OfferId, Outcome, Rule, Rules, StreamToken,
        router::PIECE_DECISIONS,
        schedule::SendQos,
        session::{ControlCommand, End},
    },
};

use super::{
    NOW, between, greet, hop, hub, local, message, offered, outputs, policy, publications, rule,
    service, tell, topic, wanted,
};

/// So many topics of the domain that other rules need several pieces.
const TOPICS: u64 = 1_000;

/// The offers to peer 3, the last ones in the order of the pieces: a topic and a service of the domain, and a topic of
/// peer 9.
const OWN: u64 = TOPICS + 1;
const NEAR: u64 = TOPICS + 2;
const SCAN: u64 = TOPICS + 3;

/// Gateway 5 with the peers 9 and 3, which want the last sources.
fn crowd() -> Hub {
    let mut hub = hub();
    greet(&mut hub, 1, 9, 9);
    greet(&mut hub, 2, 3, 3);
    let topics = (0..TOPICS).map(|it| topic(&format!("a{it}")));
    for subject in topics.chain([topic("z/own"), service("z/near")]) {
        let present = true;
        local(&mut hub, LocalEvent::Present { subject, present });
    }
    offered(&mut hub, 1, 4, topic("z/scan"), &[9]);
    offered(&mut hub, 1, 5, service("z/far"), &[9]);
    for offer in [OWN, NEAR, SCAN] {
        tell(&mut hub, 2, wanted(offer, 1));
    }
    hub
}

fn input(hub: &mut Hub, input: Input) -> Vec<Output> {
    let Ok(()) = hub.handle(NOW, input);
    outputs(hub)
}

fn deny_all(hub: &mut Hub) -> Vec<Output> {
    input(hub, Input::Policy(policy(vec![rule(Action::Deny, "**")])))
}

fn own_message() -> LocalEvent {
    LocalEvent::Message {
        subject: topic("z/own"),
        published_at: NOW,
        payload: Bytes::from_static(b"x"),
    }
}

fn request(call: u64) -> Event {
    Event::Request {
        call: PeerCall(StreamToken(call)),
        offer: OfferId(NEAR),
        deadline: None,
        payload: Bytes::new(),
    }
}

fn local_request(request: u64) -> LocalEvent {
    LocalEvent::Request {
        request: RequestId(request),
        subject: service("z/far"),
        origin: hop(9).gateway,
        deadline: None,
        payload: Bytes::new(),
    }
}

fn call(said: &[Output]) -> CallId {
    let call = said.iter().find_map(|it| match it {
        Output::Local(LocalCommand::Call { call, .. })
        | Output::Peer {
            command: Command::Call { call, .. },
            ..
        } => Some(*call),
        _ => None,
    });
    call.expect("a call")
}

/// The outcomes of calls, and the lengths of the replies.
fn answers(said: &[Output]) -> Vec<(Outcome, usize)> {
    let answer = |it: &Output| match it {
        Output::Local(LocalCommand::Reply {
            outcome, payload, ..
        })
        | Output::Peer {
            command: Command::Reply {
                outcome, payload, ..
            },
            ..
        } => Some((*outcome, payload.len())),
        _ => None,
    };
    said.iter().filter_map(answer).collect()
}

fn is_message(it: &Output) -> bool {
    let command = match it {
        Output::Peer { command, .. } => command,
        _ => return false,
    };
    matches!(command, Command::Message { .. } | Command::Call { .. })
}

/// The connections that get rules as `is_some` says, if these are the only outputs.
fn rules(said: &[Output], is_some: bool) -> Vec<u64> {
    let of = |it: &Output| match it {
        Output::Peer {
            connection,
            command: Command::Rules(rules),
        } if rules.is_some() == is_some => Some(connection.0),
        _ => None,
    };
    said.iter().map_while(of).collect()
}

//= SM2-GWR-004 test
#[test]
fn nothing_passes_that_other_rules_deny_before_they_are_announced() {
    let mut hub = crowd();
    let near = call(&tell(&mut hub, 2, request(1)));
    let far = call(&local(&mut hub, local_request(1)));
    assert_eq!(publications(&tell(&mut hub, 1, message(4, 1))), 1);
    assert!(local(&mut hub, own_message()).iter().any(is_message));
    // Every connection gets the rules before anything else.
    let said = deny_all(&mut hub);
    assert_eq!(rules(&said, true).len(), 2);
    assert!(hub.deadline().is_some(), "pieces are left");
    // Replies to calls that were made before.
    let unreachable = [(Outcome::Unreachable, 0)];
    let payload = Bytes::from_static(b"x");
    let (outcome, reply) = (Outcome::Ok, payload.clone());
    let said = local(
        &mut hub,
        LocalEvent::Replied {
            call: near,
            outcome,
            payload,
        },
    );
    assert_eq!(answers(&said), unreachable);
    let (call, payload) = (far, reply);
    let replied = Event::Reply {
        call,
        outcome,
        payload,
    };
    assert_eq!(answers(&tell(&mut hub, 1, replied)), unreachable);
    // New calls and messages: each one first withdraws its source.
    let mut said = tell(&mut hub, 2, request(2));
    assert_eq!(answers(&said), unreachable);
    let more = local(&mut hub, local_request(2));
    assert_eq!(answers(&more), unreachable);
    said.extend(more);
    said.extend(tell(&mut hub, 1, message(4, 2)));
    said.extend(local(&mut hub, own_message()));
    assert_eq!(publications(&said), 0, "{said:?}");
    assert!(!said.iter().any(is_message), "{said:?}");
    let unoffers = said.iter().filter_map(|it| match it {
        Output::Peer {
            connection: ConnectionId(2),
            command: Command::Control(ControlCommand::Unoffer { offer }),
        } => Some(offer.0),
        _ => None,
    });
    let unoffers: BTreeSet<u64> = unoffers.collect();
    assert!(
        [OWN, NEAR, SCAN].iter().all(|it| unoffers.contains(it)),
        "{unoffers:?}"
    );
}

//= SM2-GWR-004 test
#[test]
fn other_rules_are_announced_in_bounded_pieces() {
    let mut hub = crowd();
    let mut pieces = vec![deny_all(&mut hub)];
    while hub.deadline().is_some() {
        pieces.push(input(&mut hub, Input::Tick));
    }
    let longest = pieces.iter().map(Vec::len).max();
    assert!(longest <= Some(PIECE_DECISIONS), "{longest:?}");
    let all: Vec<Output> = pieces.concat();
    let unoffers: Vec<(u64, u64)> = all
        .iter()
        .filter_map(|it| match it {
            Output::Peer {
                connection,
                command: Command::Control(ControlCommand::Unoffer { offer }),
            } => Some((connection.0, offer.0)),
            _ => None,
        })
        .collect();
    // The subjects of peer 9 are offered to peer 3 only.
    assert_eq!(unoffers.len() as u64, 2 * (TOPICS + 2) + 2);
    let distinct: BTreeSet<_> = unoffers.iter().collect();
    assert_eq!(distinct.len(), unoffers.len());
    // At last the connections learn that nothing denied is left.
    assert_eq!(rules(&all[all.len() - 2..], false).len(), 2);
}

#[test]
fn the_qos_of_offers_changes_in_bounded_pieces() {
    let mut hub = crowd();
    let qos = SendQos {
        bytes_per_s: NonZeroU64::new(1_000),
        ..DEFAULT_SEND_QOS
    };
    let other = Policy {
        rules: Rules(vec![rule(Action::Allow, "**")]),
        send_qos: vec![qos],
    };
    let mut pieces = vec![input(&mut hub, Input::Policy(other))];
    while hub.deadline().is_some() {
        pieces.push(input(&mut hub, Input::Tick));
    }
    let longest = pieces.iter().map(Vec::len).max();
    assert!(longest <= Some(PIECE_DECISIONS + 2), "{longest:?}");
    let changed = pieces.iter().flatten().filter_map(|it| match it {
        Output::Peer {
            connection,
            command: Command::Change { offer, qos: to },
        } if *to == qos => Some((connection.0, offer.0)),
        _ => None,
    });
    let changed: Vec<_> = changed.collect();
    let distinct: BTreeSet<_> = changed.iter().collect();
    assert_eq!(distinct.len() as u64, 2 * (TOPICS + 2) + 2);
    assert_eq!(distinct.len(), changed.len(), "each one once");
}

//= SM2-GWR-004 test
#[test]
fn other_rules_withdraw_before_anything_else_is_said() {
    let mut hub = between();
    let qos = SendQos {
        bytes_per_s: NonZeroU64::new(1_000),
        ..DEFAULT_SEND_QOS
    };
    let (subject, present) = (topic("own"), true);
    local(&mut hub, LocalEvent::Present { subject, present });
    let deny_in = Rule {
        direction: Some(Direction::In),
        ..rule(Action::Deny, "scan")
    };
    let other = Policy {
        rules: Rules(vec![deny_in, rule(Action::Allow, "**")]),
        send_qos: vec![qos; 2],
    };
    let Ok(()) = hub.handle(NOW, Input::Policy(other));
    let said = outputs(&mut hub);
    let at = |is_it: fn(&Output) -> bool| said.iter().position(is_it);
    let unoffer = at(|it| {
        matches!(
            it,
            Output::Peer {
                connection: ConnectionId(2),
                command: Command::Control(ControlCommand::Unoffer { offer: OfferId(1) })
            }
        )
    });
    let unwant = at(|it| {
        matches!(
            it,
            Output::Peer {
                connection: ConnectionId(1),
                command: Command::Control(ControlCommand::Unwant { offer: OfferId(4) })
            }
        )
    });
    let change = at(
        |it| matches!(it, Output::Peer { command: Command::Change { qos, .. }, .. } if qos.bytes_per_s.is_some()),
    );
    assert!(unoffer.is_some() && unwant.is_some(), "{said:?}");
    assert!(unoffer.max(unwant) < change, "{said:?}");
    // A message of the ended offer that was in flight reaches nobody.
    assert!(tell(&mut hub, 1, message(4, 1)).is_empty());
}

/// The end of a peer with many offers leaves work for further pieces, and these come to an end without other rules.
#[test]
fn what_an_ended_peer_leaves_is_freed_in_pieces() {
    let mut hub = crowd();
    let ended = Event::Ended(Reason::Session(End::Closed(None)));
    tell(&mut hub, 2, ended);
    assert_eq!(hub.deadline(), Some(NOW));
    let mut pieces = 0;
    while hub.deadline().is_some() {
        pieces += 1;
        assert!(pieces < TOPICS, "the pieces do not end");
        input(&mut hub, Input::Tick);
    }
}
