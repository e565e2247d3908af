//! A node that reads the domain's pages after each step, and has watched the domain from the first
//! revision on.

use std::collections::BTreeMap;

use sm2_proto::{
    Datagram, Instant, Machine, NodeId,
    control::{Change, Changes, Item, Key, Limits, Page, ToManager, ToNode, encode_to_manager},
    manager::{Input, Manager},
};

use super::bench::{Event, read};

#[derive(Clone, Debug)]
pub(crate) struct Onlooker {
    revision: u64,
    /// The items of the pages at that revision.
    items: Vec<Item>,
    /// The items that follow from the changes to the empty domain.
    mirror: BTreeMap<Key, Item>,
}

impl Onlooker {
    pub(crate) fn new(limits: Limits) -> Self {
        Self {
            revision: 0,
            items: Vec::new(),
            mirror: BTreeMap::from([(
                Key::Domain,
                Item::Domain {
                    limits: limits.into(),
                },
            )]),
        }
    }

    /// Checks that pages show exactly the expected items, that a revision identifies one state, and
    /// that the watcher has the same items.
    //= SM2-IFC-007, SM2-WCH-002, SM2-WCH-003 test
    pub(crate) fn check(&mut self, manager: &Manager, session: NodeId, expected: &[Item]) {
        let items = list(manager, session);
        let shown: Vec<Item> = items.iter().zip(expected).map(as_waiting).collect();
        assert_eq!(shown.len(), expected.len(), "{items:?}");
        assert_eq!(items, shown);
        let revision = manager.revision();
        let changed = items != self.items;
        assert!(revision > self.revision || !changed, "revision {revision}");
        if revision > self.revision {
            self.watch(manager, session);
        }
        assert!(self.mirror.values().eq(&items), "{:?}", self.mirror);
        (self.revision, self.items) = (revision, items);
    }

    /// Applies the changes since the last call.
    fn watch(&mut self, manager: &Manager, session: NodeId) {
        let after = self.revision;
        let answer = ask(manager, session, &ToManager::Watch { after });
        let ToNode::Changes(Changes {
            revision,
            changes: Some(changes),
            more: false,
        }) = answer
        else {
            panic!("{answer:?} are not changes");
        };
        assert_eq!(revision, manager.revision());
        for change in changes {
            match change {
                Change::Set { item } => drop(self.mirror.insert(item.key(), item)),
                Change::Removed { key } => drop(self.mirror.remove(&key)),
            }
        }
    }
}

/// All pages together. The Manager is cloned, so no session is affected.
fn list(manager: &Manager, session: NodeId) -> Vec<Item> {
    let mut items = Vec::new();
    let mut after = None;
    loop {
        let answer = ask(manager, session, &ToManager::Query { after });
        let ToNode::Page(Page {
            items: more, next, ..
        }) = answer
        else {
            panic!("{answer:?} is not a page");
        };
        items.extend(more);
        after = next;
        if after.is_none() {
            return items;
        }
    }
}

/// The answer that a session would get.
fn ask(manager: &Manager, session: NodeId, frame: &ToManager) -> ToNode {
    let mut aside = manager.clone();
    let bytes = encode_to_manager(frame);
    let datagram = Datagram::new(&bytes);
    let asked = aside.handle(Instant(1), Input::Datagram { session, datagram });
    asked.expect("the driver keeps the contract");
    match aside.poll().map(read) {
        Some(Event::Sent(_, answer)) => answer,
        other => panic!("{other:?} is not an answer to {frame:?}"),
    }
}

/// The expected item. The oracle does not know which links wait, so a link may be shown as one.
fn as_waiting((shown, expected): (&Item, &Item)) -> Item {
    match (shown, expected) {
        (
            Item::Waiting { .. },
            &Item::Link {
                link,
                offering,
                demanding,
                ..
            },
        ) => Item::Waiting {
            link,
            offering,
            demanding,
        },
        _ => expected.clone(),
    }
}
