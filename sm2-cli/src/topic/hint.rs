//! What to say to somebody who waits, and nothing comes.

use std::{fmt, time::Duration};

use sm2_proto::{Contract, Kind, Mismatch, Name, NodeId, control::Item, match_contracts};

use crate::connect::Session;

/// How long nothing has to happen before it is worth a line.
pub(super) const AFTER: Duration = Duration::from_secs(1);

/// Says on standard error what `session` waits for, and why a node that is there does not match.
pub(super) fn say(session: &Session, topic: &Name, wanted: Kind, count: usize) {
    let many = if count == 1 { "" } else { "s" };
    let reason = match session.graph() {
        Ok(graph) => why(&graph.items, session.node.name(), topic, wanted),
        // What is wrong with the Manager shows where it matters.
        Err(_) => None,
    };
    let reason = reason.map_or_else(String::new, |reason| format!("; {reason}"));
    eprintln!("sm2: waiting for {count} {wanted}{many} of {topic} (Ctrl-C ends){reason}");
}

/// A counterpart that does not match.
#[derive(Clone, Debug, PartialEq, Eq)]
struct Unmatched {
    node: String,
    wanted: Kind,
}

impl fmt::Display for Unmatched {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.wanted {
            Kind::Subscriber => write!(
                f,
                "node {} subscribes, but wants every message: publish with --reliable",
                self.node
            ),
            _ => write!(
                f,
                "node {} publishes, but waits for nobody: have it publish reliably, or echo without --reliable",
                self.node
            ),
        }
    }
}

/// The first interface that would be a counterpart of `itself`, if it were not for reliability. (Two types
/// on one topic are refused when they are declared.)
fn why(items: &[Item], itself: &Name, topic: &Name, wanted: Kind) -> Option<Unmatched> {
    let node_named = |wanted: NodeId| {
        items.iter().find_map(|item| match item {
            Item::Node { node, name, .. } if *node == wanted => Some(name),
            _ => None,
        })
    };
    let interfaces = || {
        items.iter().filter_map(|item| match item {
            Item::Interface { node, contract, .. } if contract.name() == topic => {
                Some((*node, contract))
            }
            _ => None,
        })
    };
    let (_, ours) = interfaces().find(|(node, contract)| {
        node_named(*node) == Some(itself) && contract.kind() == wanted.counterpart()
    })?;
    let (node, _) = interfaces()
        .filter(|(_, theirs)| theirs.kind() == wanted)
        .find(|(_, theirs)| mismatch(ours, theirs) == Some(Mismatch::Reliability))?;
    let node = node_named(node)?.to_string();
    Some(Unmatched { node, wanted })
}

fn mismatch(ours: &Contract, theirs: &Contract) -> Option<Mismatch> {
    match_contracts(ours, theirs).err()
}
