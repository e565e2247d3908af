//! WATCH: the changes since a revision (SM2-WCH-001, SM2-WCH-002).
//!
//! A watcher polls with a revision: WATCH is answered once, with all changes since that revision. A slow tool therefore
//! gets more changes at a time, and fills no queue. Pages and changes together are exact (SM2-WCH-003), so a snapshot
//! needs no frozen copy.

use alloc::{collections::BTreeSet, vec::Vec};
use core::mem;

use super::Registry;
use crate::{
    NodeId, Violation,
    control::{Change, Changes, ToNode},
    limits::DATAGRAM_MAX,
    manager::outbox::Outbox,
};

/// The greatest size of a CHANGES without its changes: the number of the frame, the revision, the
/// option, the number of changes, and the flag for more.
const HEAD_BYTES: usize = 1 + 10 + 1 + 3 + 1;

impl Registry {
    /// WATCH: the changes, or a watcher that waits for some.
    //= SM2-WCH-001
    pub(in crate::manager) fn watch(
        &mut self,
        node: NodeId,
        after: u64,
        outbox: &mut Outbox,
    ) -> Result<(), Violation> {
        if self.watchers.contains(&node) {
            return Err(violation!(WatchTwice, "SM2-WCH-001"));
        }
        if after == self.log.revision() {
            self.watchers.insert(node);
        } else {
            let changes = self.changes(node, after);
            outbox.send(node, &changes);
        }
        Ok(())
    }

    /// Answers all watchers if the last input has changed the domain. All of them waited for a
    /// change of the revision before.
    //= SM2-WCH-001
    pub(in crate::manager) fn wake_watchers(&mut self, before: u64, outbox: &mut Outbox) {
        if self.log.revision() == before || self.watchers.is_empty() {
            return;
        }
        let watchers = mem::take(&mut self.watchers);
        if self.access.is_restricted() {
            for node in watchers {
                let changes = self.changes(node, before);
                outbox.send(node, &changes);
            }
        } else if let Some(&first) = watchers.first() {
            // All sessions see the same.
            let changes = self.changes(first, before);
            for node in watchers {
                outbox.send(node, &changes);
            }
        }
    }

    /// The changes that a session may see.
    //= SM2-WCH-002, SM2-WCH-003, SM2-ACC-010
    fn changes(&self, viewer: NodeId, after: u64) -> ToNode {
        let mut room = DATAGRAM_MAX - HEAD_BYTES;
        let mut seen = BTreeSet::new();
        let mut changes = Vec::new();
        let Some(changed) = self.log.since(after) else {
            return ToNode::Changes(Changes {
                revision: self.log.revision(),
                changes: None,
                more: false,
            });
        };
        for (revision, key) in changed {
            if !seen.insert(key) {
                continue;
            }
            let change = match self.item(key) {
                Some(item) if !self.access.sees(viewer, &item, &self.sessions) => continue,
                Some(item) => Change::Set { item },
                None => Change::Removed { key },
            };
            let Some(left) = room.checked_sub(size_bytes(&change)) else {
                return ToNode::Changes(Changes {
                    revision: revision - 1,
                    changes: Some(changes),
                    more: true,
                });
            };
            room = left;
            changes.push(change);
        }
        ToNode::Changes(Changes {
            revision: self.log.revision(),
            changes: Some(changes),
            more: false,
        })
    }
}

fn size_bytes(change: &Change) -> usize {
    postcard::experimental::serialized_size(change).unwrap_or(DATAGRAM_MAX)
}
