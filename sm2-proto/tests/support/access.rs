//! Access policies that deny something, and a Manager that applies them.
#![allow(dead_code, reason = "each test uses a part")]

use std::{collections::BTreeMap, sync::Arc};

use sm2_proto::{
    Machine, NodeId,
    control::{Item, Key, ToManager, ToNode},
    gateway::Pattern,
    manager::Input,
    policy::{AccessPolicy, Action, Binding, Effect, Members, Rule, Tables},
};

use super::{
    bench::{Bench, Event},
    contracts::name,
};

pub(crate) fn patterns(texts: &[&str]) -> Vec<Pattern> {
    texts.iter().map(|it| Pattern::new(it).unwrap()).collect()
}

pub(crate) fn deny(called: &str, action: Action, names: &[&str], nodes: &[&str]) -> Rule {
    Rule {
        name: name(called),
        effect: Effect::Deny,
        actions: [action].into_iter().collect(),
        names: patterns(names),
        members: Members::default(),
        nodes: (!nodes.is_empty()).then(|| patterns(nodes)),
        peers: None,
    }
}

pub(crate) fn tables(rules: Vec<Rule>) -> Tables {
    Tables {
        default: Effect::Allow,
        rules,
        bindings: Vec::new(),
        exclusive: Vec::new(),
    }
}

pub(crate) fn access(tables: Tables) -> Option<Arc<AccessPolicy>> {
    Some(Arc::new(AccessPolicy::new(tables).unwrap()))
}

/// Keeps the names of nodes that match from everybody.
pub(crate) fn banning(nodes: &[&str]) -> Tables {
    let bindings = vec![Binding {
        name: name("nobody"),
        nodes: patterns(nodes),
        members: Members {
            users: Some(vec![u32::MAX]),
            groups: None,
        },
    }];
    Tables {
        bindings,
        ..tables(Vec::new())
    }
}

/// Does all deferred work.
pub(crate) fn finish_work(bench: &mut Bench) -> Vec<Event> {
    let mut events = Vec::new();
    while bench.manager.deadline().is_some_and(|at| at <= bench.now) {
        events.extend(bench.input(Input::Tick));
    }
    events
}

/// All items that a session is shown.
pub(crate) fn snapshot(bench: &mut Bench, node: NodeId) -> BTreeMap<Key, Item> {
    let mut all = BTreeMap::new();
    let mut after = None;
    loop {
        let events = bench.send(node, &ToManager::Query { after });
        let [Event::Sent(_, ToNode::Page(page))] = &events[..] else {
            panic!("{events:?}");
        };
        all.extend(page.items.iter().map(|it| (it.key(), it.clone())));
        let Some(next) = page.next else {
            return all;
        };
        assert!(after < Some(next), "each page makes progress");
        after = Some(next);
    }
}
