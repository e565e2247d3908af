//! Rules have the same meaning in `explain`, in the offers and wants of the hub, and in the
//! comparison of two rule sets.

mod naive;

use std::collections::{BTreeMap, BTreeSet};

use naive::{PEERS, decide, file, id, is_good, is_name, is_pattern, kind, lines, parse, text};
use proptest::{collection::btree_set, prelude::*, test_runner::RngSeed};
use sm2_gateway::{
    Config, ConfigError,
    hub::{Hub, Input, LocalCommand, LocalEvent, Output},
    peer::{Command, ConnectionId, Event},
    shadow::{Because, Change, Effect, Seen, changes},
};
use sm2_proto::{
    Instant, Machine, Name, TypeId,
    gateway::{
        Action, Direction, GatewayId, Hop, OfferId, Subject, SubjectKind,
        session::{self, ControlCommand, Initiator},
    },
};

type Key = (SubjectKind, Name);

fn good_config(lines: &[naive::Line]) -> Config {
    parse(&file(lines).0).unwrap()
}

fn key() -> impl Strategy<Value = Key> {
    let name = text(proptest::sample::select(vec!["a", "b", "A"]));
    (kind(), name.prop_map(|it| Name::new(&it).unwrap()))
}

fn good_lines() -> impl Strategy<Value = Vec<naive::Line>> {
    lines().prop_filter("no such pattern", |it| is_good(it))
}

/// Generates the offers of each peer, and the subjects of the local domain.
fn seen() -> impl Strategy<Value = Seen> {
    let keys = || btree_set(key(), 0..6);
    (keys(), [keys(), keys(), keys()]).prop_map(|(local, offers)| Seen {
        local,
        offers: (0..).map(id).zip(offers).collect(),
    })
}

fn subject((kind, name): &Key) -> Subject {
    let bytes = || TypeId {
        name: Name::new("bytes").unwrap(),
        hash: 0,
    };
    match kind {
        SubjectKind::Topic => Subject::Topic {
            name: name.clone(),
            data: bytes(),
            reliable: false,
            latched: 0,
        },
        SubjectKind::Service => Subject::Service {
            name: name.clone(),
            request: bytes(),
            reply: bytes(),
        },
    }
}

const ME: Hop = Hop {
    gateway: GatewayId([99; 32]),
    epoch: 1,
};

/// The offers of a hub by peer, subject and origin, and the subjects that it shows and wants, by
/// subject and origin.
#[derive(Debug, Default, PartialEq, Eq)]
struct Allowed {
    offered: BTreeSet<(GatewayId, Subject, GatewayId)>,
    shown: BTreeSet<(Subject, GatewayId)>,
    wanted: BTreeSet<(Subject, GatewayId)>,
}

/// Runs a hub with these rules. Returns what it offers, shows and wants.
fn observed(config: &Config, seen: &Seen) -> Allowed {
    let mut hub = Hub::new(ME, config.policy.clone());
    let mut inputs = Vec::new();
    let mut offers = BTreeMap::new();
    let tell = |connection, event| Input::Peer {
        connection,
        initiator: Initiator::Peer,
        event,
    };
    for (connection, peer) in (1..).zip(0..PEERS.len()) {
        let greeted = Event::Session(session::Event::Greeted {
            peer: id(peer),
            epoch: 1,
            name: Name::new(PEERS[peer]).unwrap(),
        });
        inputs.push(tell(ConnectionId(connection), greeted));
        for (offer, key) in (1..).zip(&seen.offers[&id(peer)]) {
            offers.insert(
                (ConnectionId(connection), OfferId(offer)),
                (subject(key), id(peer)),
            );
            let offered = Event::Session(session::Event::Offered {
                offer: OfferId(offer),
                subject: subject(key),
                path: vec![Hop {
                    gateway: id(peer),
                    epoch: 1,
                }],
            });
            inputs.push(tell(ConnectionId(connection), offered));
        }
    }
    let present = seen.local.iter().map(|key| LocalEvent::Present {
        subject: subject(key),
        present: true,
    });
    let taken = offers.values().map(|(subject, origin)| LocalEvent::Taken {
        subject: subject.clone(),
        origin: *origin,
        taken: Some(1),
    });
    inputs.extend(present.chain(taken).map(Input::Local));
    let mut allowed = Allowed::default();
    for input in inputs {
        let Ok(()) = hub.handle(Instant(1), input);
        while let Some(output) = hub.poll() {
            match output {
                Output::Peer {
                    connection,
                    command: Command::Offer { subject, path, .. },
                } => {
                    let peer = id(usize::try_from(connection.0).unwrap() - 1);
                    let is_new = allowed.offered.insert((peer, subject, path[0].gateway));
                    assert!(is_new, "offered twice");
                }
                Output::Peer {
                    connection,
                    command: Command::Control(ControlCommand::Want { offer, .. }),
                } => drop(allowed.wanted.insert(offers[&(connection, offer)].clone())),
                Output::Local(LocalCommand::DeclareProxy {
                    subject, origin, ..
                }) => drop(allowed.shown.insert((subject, origin))),
                _ => {}
            }
        }
    }
    allowed
}

/// Returns what the hub should offer, show and want according to `explain`.
fn explained(config: &Config, seen: &Seen) -> Allowed {
    let allows = |(kind, name): &Key, direction, peer: &GatewayId| {
        config.explain(*kind, name, direction, peer).0 == Action::Allow
    };
    let mut allowed = Allowed::default();
    for to in (0..PEERS.len()).map(id) {
        for key in seen
            .local
            .iter()
            .filter(|it| allows(it, Direction::Out, &to))
        {
            allowed.offered.insert((to, subject(key), ME.gateway));
        }
    }
    for (from, offers) in &seen.offers {
        for key in offers.iter().filter(|it| allows(it, Direction::In, from)) {
            allowed.shown.insert((subject(key), *from));
            allowed.wanted.insert((subject(key), *from));
            for to in (0..PEERS.len()).map(id) {
                if to != *from && allows(key, Direction::Out, &to) {
                    allowed.offered.insert((to, subject(key), *from));
                }
            }
        }
    }
    allowed
}

/// Returns true if the subject passes now in this direction, according to the plain list.
fn goes(lines: &[naive::Line], seen: &Seen, of: &Key, direction: Direction, peer: usize) -> bool {
    let (kind, name) = (of.0, of.1.as_str());
    let allows = |direction, peer| decide(lines, kind, name, direction, peer).0;
    let others = (0..PEERS.len()).filter(|it| *it != peer && seen.offers[&id(*it)].contains(of));
    match direction {
        Direction::In => seen.offers[&id(peer)].contains(of) && allows(Direction::In, peer),
        Direction::Out => {
            let is_here = seen.local.contains(of);
            let is_here = is_here || others.into_iter().any(|it| allows(Direction::In, it));
            is_here && allows(Direction::Out, peer)
        }
    }
}

proptest! {
    #![proptest_config(ProptestConfig {
        cases: 512,
        rng_seed: RngSeed::Fixed(sm2_test_support::seed()),
        ..ProptestConfig::default()
    })]

    /// A rule file is either refused, with the line of a wrong pattern, or `explain` agrees with
    /// the plain list.
    //= SM2-GWR-001, SM2-GWR-002 test
    #[test]
    fn explain_says_what_the_first_rule_that_fits_says(
        lines in lines(),
        kind in kind(),
        name in text(naive::segment()),
        peer in 0..PEERS.len(),
    ) {
        let name = match Name::new(&name) {
            Ok(it) => it,
            Err(_) => {
                prop_assert!(!is_name(&name), "{name:?}");
                return Ok(());
            }
        };
        prop_assert!(is_name(name.as_str()), "{name}");
        let (text, at) = file(&lines);
        let config = match parse(&text) {
            Ok(config) => config,
            Err(ConfigError::Toml { line, .. } | ConfigError::Value { line, .. }) => {
                prop_assert!(!is_good(&lines));
                let wrong = text.lines().nth(line - 1).unwrap();
                let wrong = wrong.strip_prefix("names = \"").and_then(|it| it.strip_suffix('"'));
                prop_assert!(wrong.is_some_and(|it| !is_pattern(it)), "{line}: {wrong:?}");
                return Ok(());
            }
            Err(error) => return Err(TestCaseError::fail(error.to_string())),
        };
        prop_assert!(is_good(&lines));
        for direction in [Direction::In, Direction::Out] {
            let (allow, rule) = decide(&lines, kind, name.as_str(), direction, peer);
            let action = if allow { Action::Allow } else { Action::Deny };
            let explained = config.explain(kind, &name, direction, &id(peer));
            prop_assert_eq!(explained, (action, rule.map(|it| at[it])));
        }
    }

    /// Uses several names from several sides, some of them passed on from one peer to another.
    //= SM2-GWR-003 test
    #[test]
    fn what_is_carried_is_what_explain_says(lines in good_lines(), seen in seen()) {
        let config = good_config(&lines);
        prop_assert_eq!(observed(&config, &seen), explained(&config, &seen));
    }

    #[test]
    fn a_shadow_shows_exactly_what_would_change(
        now in good_lines(),
        then in good_lines(),
        seen in seen(),
    ) {
        let sets = [&now, &then].map(|it| good_config(it).rule_set());
        let changes = changes(&sets[0], &sets[1], &seen);
        let all: BTreeSet<&Key> = seen.offers.values().flatten().chain(&seen.local).collect();
        let mut expected = BTreeMap::new();
        for peer in 0..PEERS.len() {
            for of in &all {
                for direction in [Direction::In, Direction::Out] {
                    let [before, after] =
                        [&now, &then].map(|it| goes(it, &seen, of, direction, peer));
                    if before != after {
                        expected.insert((id(peer), direction, (*of).clone()), after);
                    }
                }
            }
        }
        let found: BTreeMap<_, _> = changes
            .iter()
            .map(|it| ((it.peer, it.direction, it.of.clone()), it.effect == Effect::Starts))
            .collect();
        prop_assert_eq!(found.len(), changes.len());
        prop_assert_eq!(found, expected);
        for Change { peer, direction, of, effect, because } in changes {
            let starts = effect == Effect::Starts;
            // The rule that a change names decides it: for this peer, or for the peer that the
            // subject comes from.
            let Because::Rule(rule) = because else {
                prop_assert!(!starts && because == Because::NoRule);
                continue;
            };
            let says_so = |direction, peer| {
                let by = decide(&then, of.0, of.1.as_str(), direction, peer);
                by == (starts, Some(rule))
            };
            let peer = (0..PEERS.len()).find(|it| id(*it) == peer).unwrap();
            let is_so = says_so(direction, peer)
                || (0..PEERS.len()).any(|it| !starts && says_so(Direction::In, it));
            prop_assert!(is_so);
        }
    }
}

#[test]
fn peers_that_are_not_in_both_files_change_all_of_theirs() {
    let lines = "[[rule]]\naction = \"allow\"\nnames = \"**\"\n";
    let (head, _) = file(&[]);
    let config = |text: &str| parse(&(text.to_owned() + lines)).unwrap().rule_set();
    let at = head.rfind("[[peer]]").unwrap();
    let (all, less) = (config(&head), config(&head[..at]));
    let scan = (SubjectKind::Topic, Name::new("scan").unwrap());
    let seen = Seen {
        local: BTreeSet::from([scan.clone()]),
        offers: BTreeMap::new(),
    };
    let change = |effect, because| Change {
        peer: id(2),
        direction: Direction::Out,
        of: scan.clone(),
        effect,
        because,
    };
    assert_eq!(changes(&all, &all, &seen), []);
    assert_eq!(
        changes(&all, &less, &seen),
        [change(Effect::Stops, Because::NoPeer)]
    );
    assert_eq!(
        changes(&less, &all, &seen),
        [change(Effect::Starts, Because::Rule(0))]
    );
}
