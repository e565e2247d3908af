//! RELOAD: who may have the access policy read again, and the answers (SM2-ACC-016, SM2-ACC-017).

use alloc::borrow::ToOwned;

use super::{Manager, Output, session::Session};
use crate::{
    NodeId, Violation,
    control::{PolicyProblem, ReloadOutcome, ToNode},
    limits::RELOAD_TEXT_MAX,
};

/// The user id of root.
const ROOT: u32 = 0;

impl Manager {
    /// Sets the user of the Manager's process. Its sessions and those of root may have the access
    /// policy read again. To be called before the first input; without it, only root may.
    //= SM2-ACC-017
    #[must_use]
    pub const fn with_owner(mut self, uid: u32) -> Self {
        self.reload_requests.owner = Some(uid);
        self
    }

    /// RELOAD.
    //= SM2-ACC-016, SM2-ACC-017
    pub(super) fn reload(&mut self, node: NodeId) -> Result<(), Violation> {
        if self.reload_requests.waits(node) {
            return Err(violation!(ReloadTwice, "SM2-ACC-016"));
        }
        let uid = self.sessions.get(&node).map(|it| it.credentials().uid);
        if uid == Some(ROOT) || (uid.is_some() && uid == self.reload_requests.owner) {
            self.reload_requests.insert(node);
            self.outputs.push_back(Output::ReadAccessPolicy);
        } else {
            let outcome = ReloadOutcome::NotPermitted;
            self.send(node, &ToNode::Reloaded { outcome });
        }
        Ok(())
    }

    /// The policy was read. `is_missing`: the domain had none, and has none now.
    //= SM2-ACC-016
    pub(super) fn policy_was_read(&mut self, is_missing: bool) {
        if is_missing {
            self.answer_readers(&ReloadOutcome::NoPolicy);
        } else {
            self.reload_requests.begin_applying();
        }
    }

    /// The policy cannot be used.
    //= SM2-ACC-013, SM2-ACC-016
    pub(super) fn refuse_reloads(&mut self, problem: PolicyProblem, text: &str) {
        let text = start_of(text).to_owned();
        self.answer_readers(&ReloadOutcome::Unusable { problem, text });
    }

    fn answer_readers(&mut self, outcome: &ReloadOutcome) {
        for node in self.reload_requests.take_reading() {
            let outcome = outcome.clone();
            self.send(node, &ToNode::Reloaded { outcome });
        }
    }

    /// Answers the sessions that wait for the policy, once it is applied. Those whose names it denies
    /// are ended after their answer.
    //= SM2-ACC-014, SM2-ACC-016
    pub(super) fn answer_reloads(&mut self) {
        if !self
            .reload
            .is_confirmed(|it| self.reload_requests.is_applying(it))
        {
            return;
        }
        for node in self.reload_requests.take_applying() {
            let outcome = ReloadOutcome::Applied;
            self.send(node, &ToNode::Reloaded { outcome });
        }
    }

    /// Whether each RELOAD without an answer belongs to a welcomed session.
    pub(super) fn reload_requests_agree(&self) -> bool {
        let welcomed = |it| self.sessions.get(&it).and_then(Session::node).is_some();
        self.reload_requests.sessions().all(welcomed)
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
