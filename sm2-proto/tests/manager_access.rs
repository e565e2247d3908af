//! The access policy at the Manager: what it refuses, and what sessions see.

// Shows ACC-ENFORCE (proptest), bound: cases of each clause; sampled steps of up to four nodes with the smallest parts
// of work.

use std::collections::BTreeMap;

use crate::support::{
    access::snapshot,
    bench::{Bench, Event, UNLIMITED, seen_by},
    cases,
    contracts::{client, data, name, publisher, server, subscriber},
};
use proptest::{collection::vec, prelude::*};
use sm2_proto::{
    Contract, EntityId, FdFacts, InterfaceId, NodeId, Quota, Refusal, Seals,
    control::{Change, Item, Key, Limit, Limits, ToManager, ToNode},
    gateway::Pattern,
    manager::Input,
    policy::{AccessPolicy, Action, ActionSet, Binding, Effect, Exclusive, Members, Rule, Tables},
};

/// Users of these tests.
const ADMIN: u32 = 9;
const GUEST: u32 = 5;

fn patterns(texts: &[&str]) -> Vec<Pattern> {
    texts.iter().map(|it| Pattern::new(it).unwrap()).collect()
}

fn members(users: &[u32], groups: &[u32]) -> Members {
    let some = |ids: &[u32]| (!ids.is_empty()).then(|| ids.to_vec());
    Members {
        users: some(users),
        groups: some(groups),
    }
}

fn allow(called: &str, actions: &[Action], names: &[&str], members: Members) -> Rule {
    Rule {
        name: name(called),
        effect: Effect::Allow,
        actions: actions.iter().copied().collect(),
        names: patterns(names),
        members,
        nodes: None,
        peers: None,
    }
}

/// The administrator may do everything; the guest may see what is below `open`.
fn tables(rules: Vec<Rule>) -> Tables {
    let admin = Rule {
        actions: ActionSet::ALL,
        ..allow("admin", &[], &["**"], members(&[ADMIN], &[]))
    };
    let see = allow("see", &[Action::See], &["open/**"], members(&[GUEST], &[]));
    Tables {
        default: Effect::Deny,
        rules: [vec![admin, see], rules].concat(),
        bindings: Vec::new(),
        exclusive: Vec::new(),
    }
}

fn bench_with(limits: Limits, tables: Tables) -> Bench {
    let mut bench = Bench::new(limits);
    let access = AccessPolicy::new(tables).unwrap();
    bench.manager = bench.manager.with_access_policy(access);
    bench
}

fn refusal(events: &[Event]) -> Option<&Refusal> {
    match events {
        [
            Event::Sent(_, ToNode::DeclareRefused { reason, .. } | ToNode::HelloRefused { reason }),
        ] => Some(reason),
        _ => None,
    }
}

fn denied(rule: Option<&str>) -> Refusal {
    Refusal::Denied {
        rule: rule.map(name),
    }
}

//= SM2-ACC-008 test
#[test]
fn a_binding_refuses_names_of_nodes() {
    let bound = Binding {
        name: name("arms"),
        nodes: patterns(&["arm/*"]),
        members: members(&[], &[70, 100]),
    };
    let limits = UNLIMITED.with(Limit::SessionsPerUser, 1);
    let tables = Tables {
        bindings: vec![bound],
        ..tables(Vec::new())
    };
    let mut bench = bench_with(limits, tables);
    let reason = denied(Some("arms"));
    let stranger = bench.connect(GUEST);
    assert_eq!(refusal(&bench.hello(stranger, "arm/left")), Some(&reason));
    // The group of the credentials counts, and so do the further groups.
    bench.node(100, "arm/left");
    let member = bench.connect(GUEST + 1);
    let gids = &[1, 70];
    bench.input(Input::Groups {
        session: member,
        gids,
    });
    // The binding does not refuse the name any more, but it is taken.
    let taken = Some(&Refusal::NameTaken);
    assert_eq!(refusal(&bench.hello(member, "arm/left")), taken);
    assert_eq!(refusal(&bench.hello(member, "arm/right")), None);
    // Denial comes before the taken name and the quota, and after the version.
    assert_eq!(refusal(&bench.hello(stranger, "arm/left")), Some(&reason));
    let versions = |min_version| ToManager::Hello {
        min_version,
        max_version: 9,
        name: name("arm/left"),
        resuming: false,
    };
    let events = bench.send(stranger, &versions(2));
    assert_eq!(refusal(&events), Some(&Refusal::Version { min: 1, max: 1 }));
    bench.node(GUEST, "leg");
    let second = bench.connect(GUEST);
    assert_eq!(refusal(&bench.hello(second, "arm/third")), Some(&reason));
    let quota = Refusal::Quota {
        quota: Quota::SessionsPerUser,
        limit: 1,
    };
    assert_eq!(refusal(&bench.hello(second, "third")), Some(&quota));
}

//= SM2-ACC-009 test
#[test]
fn each_kind_of_interface_needs_its_right() {
    let kinds = [
        (Action::Publish, publisher("a", &data("A"))),
        (Action::Subscribe, subscriber("a", None)),
        (Action::Serve, server("a", &data("A"), &data("B"))),
        (Action::Call, client("a", None)),
    ];
    for (action, _) in &kinds {
        let rule = allow("one", &[*action], &["a"], members(&[GUEST], &[]));
        let no = Rule {
            effect: Effect::Deny,
            ..allow("no", &[Action::Publish], &["b"], Members::default())
        };
        let mut bench = bench_with(UNLIMITED, tables(vec![rule, no]));
        let guest = bench.node(GUEST, "guest");
        for (number, (other, contract)) in (1..).zip(&kinds) {
            let events = bench.declare(guest, number, contract);
            let expected = (other != action).then(|| denied(None));
            assert_eq!(refusal(&events), expected.as_ref(), "{action} {other}");
        }
        let events = bench.declare(guest, 5, &publisher("b", &data("A")));
        assert_eq!(refusal(&events), Some(&denied(Some("no"))));
        // A refusal is shown to its own node, so that `why` can name the rule.
        let shown = snapshot(&mut bench, guest);
        let reasons = shown.values().filter_map(|it| match it {
            Item::Refusal { reason, .. } => Some(reason.clone()),
            _ => None,
        });
        let mut expected = vec![denied(None); 3];
        expected.push(denied(Some("no")));
        assert_eq!(reasons.collect::<Vec<_>>(), expected);
        let admin = bench.node(ADMIN, "admin");
        bench.declared(admin, 1, &publisher("b", &data("A")));
    }
}

//= SM2-ACC-009 test
#[test]
fn an_exclusive_topic_has_one_publisher() {
    let entry = Exclusive {
        name: name("motion"),
        topics: patterns(&["cmd_vel"]),
    };
    let tables = Tables {
        default: Effect::Allow,
        exclusive: vec![entry],
        ..tables(Vec::new())
    };
    let limits = UNLIMITED.with(Limit::InterfacesPerSession, 2);
    let mut bench = bench_with(limits, tables);
    let (a, b) = (bench.node(GUEST, "a"), bench.node(ADMIN, "b"));
    let velocity = publisher("cmd_vel", &data("Twist"));
    let exclusive = Refusal::Exclusive {
        rule: name("motion"),
    };
    bench.declared(a, 1, &subscriber("cmd_vel", None));
    bench.declared(b, 1, &subscriber("cmd_vel", None));
    bench.declared(b, 2, &velocity);
    assert_eq!(refusal(&bench.declare(a, 2, &velocity)), Some(&exclusive));
    // Also for the node that has the first one, and before a quota and a wrong type.
    assert_eq!(refusal(&bench.declare(b, 3, &velocity)), Some(&exclusive));
    let other = publisher("cmd_vel", &data("Other"));
    assert_eq!(refusal(&bench.declare(a, 3, &other)), Some(&exclusive));
    // A service of that name is not a topic, and other topics have several publishers.
    bench.withdraw(a, 1);
    bench.declared(a, 4, &server("cmd_vel", &data("A"), &data("B")));
    bench.withdraw(a, 4);
    bench.withdraw(b, 2);
    bench.declared(a, 5, &velocity);
    bench.close(a);
    bench.declared(b, 4, &velocity);
}

//= SM2-ACC-011 test
#[test]
fn counters_need_a_right() {
    let rule = allow(
        "counters",
        &[Action::ReadCounters],
        &["open/*"],
        members(&[GUEST], &[]),
    );
    let mut bench = bench_with(UNLIMITED, tables(vec![rule]));
    let guest = bench.node(GUEST, "guest");
    let (open, shut) = (bench.node(ADMIN, "open/a"), bench.node(ADMIN, "shut/a"));
    let file = FdFacts {
        regular: true,
        size_bytes: 1_024,
        seals: Seals::POOLED,
    };
    for node in [guest, open, shut] {
        let bytes = sm2_proto::control::encode_to_manager(&ToManager::Counters);
        let events = bench.datagram(
            node,
            sm2_proto::Datagram {
                fds: &[file],
                ..sm2_proto::Datagram::new(&bytes)
            },
        );
        assert_eq!(events, [Event::CountersKept(node)]);
    }
    let inspect = |bench: &mut Bench, from, node| {
        let events = bench.send(from, &ToManager::Inspect { node });
        matches!(events[..], [Event::CountersSent(..)])
    };
    assert!(inspect(&mut bench, guest, guest), "its own");
    assert!(inspect(&mut bench, guest, open));
    assert!(!inspect(&mut bench, guest, shut));
    assert!(inspect(&mut bench, open, shut));
    let events = bench.send(guest, &ToManager::Inspect { node: shut });
    assert_eq!(
        events,
        [Event::Sent(guest, ToNode::NotInspected { node: shut })]
    );
}

/// A page passes over a bounded number of items that the session does not see.
//= SM2-ACC-010 test
#[test]
fn a_page_without_items_leads_on() {
    let mut bench = bench_with(UNLIMITED, tables(Vec::new()));
    let admin = bench.node(ADMIN, "shut/admin");
    for number in 1..=1_100 {
        bench.declared(admin, number, &subscriber("shut/a", None));
    }
    let guest = bench.node(GUEST, "guest");
    let mut pages = Vec::new();
    let mut after = None;
    loop {
        let events = bench.send(guest, &ToManager::Query { after });
        let [Event::Sent(_, ToNode::Page(page))] = &events[..] else {
            panic!("{events:?}");
        };
        pages.push(page.items.len());
        after = page.next;
        if after.is_none() {
            break;
        }
    }
    // The domain; nothing; the guest itself.
    assert_eq!(pages, [1, 0, 1]);
}

#[derive(Clone, Debug)]
enum Step {
    Connect(bool),
    Declare(usize, bool, bool),
    Withdraw(usize, usize),
    Close(usize),
    Tick,
}

fn step() -> impl Strategy<Value = Step> {
    prop_oneof![
        2 => any::<bool>().prop_map(Step::Connect),
        6 => (0..4_usize, any::<bool>(), any::<bool>())
            .prop_map(|(node, publishes, open)| Step::Declare(node, publishes, open)),
        2 => (0..4_usize, 0..4_usize).prop_map(|(node, which)| Step::Withdraw(node, which)),
        1 => (0..4_usize).prop_map(Step::Close),
        3 => Just(Step::Tick),
    ]
}

/// A domain, the names of all that ever was in it, and what the guest knows by CHANGES.
struct World {
    bench: Bench,
    guest: NodeId,
    nodes: Vec<(NodeId, Vec<u64>)>,
    open: BTreeMap<EntityId, bool>,
    known: BTreeMap<Key, Item>,
    revision: u64,
    numbers: u64,
}

impl World {
    fn new() -> Self {
        // Each input does as little as possible, so that links end in parts.
        let limits = UNLIMITED.with(Limit::WorkPerTurn, 1);
        let mut bench = bench_with(limits, tables(Vec::new()));
        let admin = bench.node(ADMIN, "shut/admin");
        let guest = bench.node(GUEST, "guest");
        let known = snapshot(&mut bench, guest);
        let revision = bench.manager.revision();
        let mut open = BTreeMap::new();
        open.insert(EntityId::node(admin), false);
        open.insert(EntityId::node(guest), true);
        Self {
            bench,
            guest,
            nodes: Vec::new(),
            open,
            known,
            revision,
            numbers: 0,
        }
    }

    fn step(&mut self, step: &Step) {
        self.numbers += 1;
        let number = self.numbers;
        match *step {
            Step::Connect(open) => {
                let word = if open { "open" } else { "shut" };
                let node = self.bench.node(ADMIN, &format!("{word}/{number}"));
                self.open.insert(EntityId::node(node), open);
                self.nodes.push((node, Vec::new()));
            }
            Step::Declare(at, publishes, open) => {
                let Some((node, interfaces)) = self.nodes.get_mut(at) else {
                    return;
                };
                let topic = if open { "open/topic" } else { "shut/topic" };
                let contract: Contract = match publishes {
                    true => publisher(topic, &data("A")),
                    false => subscriber(topic, None),
                };
                let interface = InterfaceId(number);
                let node = *node;
                let is_open = open && self.open[&EntityId::node(node)];
                self.open.insert(EntityId { node, interface }, is_open);
                interfaces.push(number);
                self.bench.declare(node, number, &contract);
            }
            Step::Withdraw(at, which) => {
                let Some((node, interfaces)) = self.nodes.get_mut(at) else {
                    return;
                };
                if which < interfaces.len() {
                    let interface = interfaces.remove(which);
                    self.bench.withdraw(*node, interface);
                }
            }
            Step::Close(at) => {
                if at < self.nodes.len() {
                    let (node, _) = self.nodes.remove(at);
                    self.bench.close(node);
                }
            }
            Step::Tick => drop(self.bench.input(Input::Tick)),
        }
    }

    fn is_open(&self, item: &Item) -> bool {
        match item {
            Item::Domain { .. } => true,
            Item::Link {
                offering,
                demanding,
                ..
            }
            | Item::Unlinked {
                offering,
                demanding,
                ..
            } => self.open[offering] && self.open[demanding],
            item => match item.key() {
                Key::Member { entity } | Key::Claim { entity, .. } => self.open[&entity],
                key => panic!("{key:?}"),
            },
        }
    }

    /// Applies the changes since the last call.
    fn watch(&mut self) {
        while self.bench.manager.revision() != self.revision {
            let after = self.revision;
            let events = self.bench.send(self.guest, &ToManager::Watch { after });
            let mut frames = seen_by(&events, self.guest);
            let Some(ToNode::Changes(changes)) = frames.pop() else {
                panic!("{events:?}");
            };
            for change in changes.changes.expect("few changes") {
                match change {
                    Change::Set { item } => drop(self.known.insert(item.key(), item)),
                    Change::Removed { key } => drop(self.known.remove(&key)),
                }
            }
            self.revision = changes.revision;
        }
    }
}

proptest! {
    #![proptest_config(cases(400))]

    /// Pages and changes show the guest exactly the items that it may see, also while links end.
    //= SM2-ACC-010 test
    #[test]
    fn a_session_sees_exactly_what_the_policy_allows(
        steps in vec((step(), any::<bool>()), 1..40),
    ) {
        let mut world = World::new();
        for (step, watches) in steps {
            world.step(&step);
            let guest = world.guest;
            let shown = snapshot(&mut world.bench, guest);
            let all = snapshot(&mut world.bench, NodeId(1));
            let expected = all.into_iter().filter(|(_, it)| world.is_open(it));
            let expected: BTreeMap<_, _> = expected.collect();
            prop_assert_eq!(&shown, &expected);
            if watches {
                world.watch();
                prop_assert_eq!(&world.known, &expected);
            }
        }
    }
}
