//! RELOAD: who may have the access policy read again, and the answers (SM2-ACC-016, SM2-ACC-017).

use alloc::{borrow::ToOwned, collections::BTreeSet};
use core::mem;

use super::{Output, outbox::Outbox};
use crate::{
    NodeId, Violation,
    control::{PolicyProblem, ReloadOutcome, ToNode},
    limits::RELOAD_TEXT_MAX,
};

/// The user id of root.
const ROOT: u32 = 0;

/// The user that may ask, and the sessions whose RELOAD is not answered.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub(super) struct ReloadRequests {
    /// The user of the Manager's process, who may have the policy read again.
    pub(super) owner: Option<u32>,
    /// Those whose policy is not read yet.
    reading: BTreeSet<NodeId>,
    /// Those whose policy is read, and not applied yet.
    applying: BTreeSet<NodeId>,
}

impl ReloadRequests {
    pub(super) const fn new() -> Self {
        Self {
            owner: None,
            reading: BTreeSet::new(),
            applying: BTreeSet::new(),
        }
    }

    /// RELOAD of a session of this user.
    //= SM2-ACC-016, SM2-ACC-017
    pub(super) fn ask(
        &mut self,
        node: NodeId,
        uid: u32,
        outbox: &mut Outbox,
    ) -> Result<(), Violation> {
        if self.reading.contains(&node) || self.is_applying(node) {
            return Err(violation!(ReloadTwice, "SM2-ACC-016"));
        }
        if uid == ROOT || Some(uid) == self.owner {
            self.reading.insert(node);
            outbox.push(Output::ReadAccessPolicy);
        } else {
            answer([node], &ReloadOutcome::NotPermitted, outbox);
        }
        Ok(())
    }

    /// The policy was read: all sessions that asked wait until it is applied. `is_missing`: the
    /// domain had none, and has none now.
    //= SM2-ACC-016
    pub(super) fn policy_was_read(&mut self, is_missing: bool, outbox: &mut Outbox) {
        if is_missing {
            answer(
                mem::take(&mut self.reading),
                &ReloadOutcome::NoPolicy,
                outbox,
            );
        } else {
            self.applying.append(&mut self.reading);
        }
    }

    /// The policy cannot be used.
    //= SM2-ACC-013, SM2-ACC-016
    pub(super) fn refuse(&mut self, problem: PolicyProblem, text: &str, outbox: &mut Outbox) {
        let text = start_of(text).to_owned();
        let outcome = ReloadOutcome::Unusable { problem, text };
        answer(mem::take(&mut self.reading), &outcome, outbox);
    }

    /// The policy is applied. The sessions whose names it denies are ended after their answer.
    //= SM2-ACC-014, SM2-ACC-016
    pub(super) fn policy_is_applied(&mut self, outbox: &mut Outbox) {
        answer(
            mem::take(&mut self.applying),
            &ReloadOutcome::Applied,
            outbox,
        );
    }

    /// The session is over.
    pub(super) fn forget(&mut self, node: NodeId) {
        self.reading.remove(&node);
        self.applying.remove(&node);
    }

    /// Whether the session waits until the policy is applied.
    pub(super) fn is_applying(&self, node: NodeId) -> bool {
        self.applying.contains(&node)
    }

    /// The sessions that wait for an answer.
    pub(super) fn sessions(&self) -> impl Iterator<Item = NodeId> {
        self.reading.union(&self.applying).copied()
    }
}

fn answer(nodes: impl IntoIterator<Item = NodeId>, outcome: &ReloadOutcome, outbox: &mut Outbox) {
    for node in nodes {
        let outcome = outcome.clone();
        outbox.send(node, &ToNode::Reloaded { outcome });
    }
}

/// The longest start of a text that a RELOADED may carry.
fn start_of(text: &str) -> &str {
    let mut end = text.len().min(RELOAD_TEXT_MAX);
    while !text.is_char_boundary(end) {
        end -= 1;
    }
    text.get(..end).unwrap_or_default()
}
