//! The last events of a domain, found in the changes that the Manager reports.

use std::{
    collections::{BTreeMap, BTreeSet, VecDeque},
    time::{SystemTime, UNIX_EPOCH},
};

use serde::Serialize;
use sm2_node::Node;
use sm2_proto::{
    Farewell, Name, NodeId, ViolationKind,
    control::{Change, Item, UnlinkedReason},
    domain::Domain,
};

use crate::{snapshot::reason_text, view::View};

/// How many events are kept.
const EVENTS: usize = 200;

/// The last events, oldest first.
#[derive(Debug, Default)]
pub(super) struct Events {
    list: VecDeque<Event>,
    /// The number of events so far.
    count: u64,
    epoch: Option<u64>,
    nodes: BTreeMap<NodeId, Name>,
}

/// An event.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub(super) struct Event {
    /// Its number, which identifies it.
    number: u64,
    /// Milliseconds since 1970 (UTC).
    at_ms: u64,
    kind: Kind,
    node: Option<String>,
    /// The topic or service.
    name: Option<String>,
    /// The rest of a sentence that begins with the node, or a sentence.
    text: String,
}

/// The kinds of events.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
enum Kind {
    Joined,
    Left,
    /// The Manager refused an interface.
    Refusal,
    /// A link ended because one side broke the protocol.
    Violation,
    /// Two interfaces match and are not linked, for another reason.
    Unlinked,
    /// Another Manager serves the domain.
    TakeOver,
}

impl Events {
    /// Starts with a domain as it is. `node` is the node of this command, which has no events.
    pub(super) fn new(node: &Node, domain: &Domain) -> Self {
        Self {
            epoch: node.epoch(),
            nodes: others(node, domain),
            ..Self::default()
        }
    }

    pub(super) fn list(&self) -> &VecDeque<Event> {
        &self.list
    }

    /// Adds the events of these changes, after which the domain is `domain`.
    pub(super) fn add(&mut self, node: &Node, domain: &Domain, changes: &[Change]) {
        if changes.is_empty() {
            return;
        }
        let nodes = others(node, domain);
        let before = std::mem::replace(&mut self.nodes, nodes.clone());
        let epoch = node.epoch();
        let is_new = epoch.is_some() && self.epoch != epoch;
        if is_new {
            self.epoch = epoch;
            self.push(
                Kind::TakeOver,
                None,
                None,
                "Another Manager has taken over.".into(),
            );
        }
        // Another Manager gives other numbers to the same nodes.
        let [old_names, new_names] =
            [&before, &nodes].map(|it| it.values().collect::<BTreeSet<_>>());
        for (id, name) in &before {
            if !(nodes.contains_key(id) || is_new && new_names.contains(name)) {
                self.push(Kind::Left, Some(name), None, "left".into());
            }
        }
        for (id, name) in &nodes {
            if !(before.contains_key(id) || is_new && old_names.contains(name)) {
                self.push(Kind::Joined, Some(name), None, "joined".into());
            }
        }
        let view = View::new(domain);
        for change in changes {
            if let Change::Set { item } = change {
                self.add_item(&view, item);
            }
        }
    }

    fn add_item(&mut self, view: &View<'_>, item: &Item) {
        match item {
            Item::Refusal {
                entity,
                contract,
                reason,
            } => {
                let node = self.nodes.get(&entity.node).cloned();
                let (kind, name) = (contract.kind(), contract.name());
                let text = format!("may not be {} of {name}: {reason}", kind.as_str());
                self.push(Kind::Refusal, node.as_ref(), Some(name), text);
            }
            Item::Unlinked {
                offering,
                demanding,
                reason,
            } => {
                let kind = match *reason {
                    UnlinkedReason::Ended { code } if ViolationKind::from_code(code).is_some() => {
                        Kind::Violation
                    }
                    UnlinkedReason::Ended { code }
                        if Farewell::from_code(code) == Some(Farewell::Done) =>
                    {
                        return;
                    }
                    _ => Kind::Unlinked,
                };
                let node = self.nodes.get(&offering.node).cloned();
                let name = view
                    .domain
                    .interface(*offering)
                    .map(|it| it.contract.name());
                let demanding = view.title(*demanding);
                let text = format!(
                    "is not linked with {demanding}: {}",
                    reason_text(view, *reason)
                );
                self.push(kind, node.as_ref(), name, text);
            }
            Item::Domain { .. }
            | Item::Node { .. }
            | Item::Interface { .. }
            | Item::Link { .. }
            | Item::Claim { .. }
            | Item::Waiting { .. } => {}
        }
    }

    fn push(&mut self, kind: Kind, node: Option<&Name>, name: Option<&Name>, text: String) {
        let now = SystemTime::now().duration_since(UNIX_EPOCH);
        self.count += 1;
        self.list.push_back(Event {
            number: self.count,
            at_ms: now.map_or(0, |it| u64::try_from(it.as_millis()).unwrap_or(u64::MAX)),
            kind,
            node: node.map(Name::to_string),
            name: name.map(Name::to_string),
            text,
        });
        if self.list.len() > EVENTS {
            self.list.pop_front();
        }
    }
}

/// The nodes of a domain, without that of this command.
fn others(node: &Node, domain: &Domain) -> BTreeMap<NodeId, Name> {
    let others = domain.nodes().filter(|it| it.name != node.name());
    others.map(|it| (it.node, it.name.clone())).collect()
}
