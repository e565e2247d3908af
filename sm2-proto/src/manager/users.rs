//! The connections, sessions and interfaces that each user has, for the quotas per user.

#[cfg(any(kani, test))]
mod proofs;

use alloc::collections::BTreeMap;

use super::{
    policy::{Policy, within},
    session::Session,
};
use crate::{Quota, Refusal};

/// The usage of one user.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
struct Usage {
    greeting: usize,
    welcomed: usize,
    interfaces: usize,
}

/// The usage of each user. A user without any has no entry.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub(super) struct Users(BTreeMap<u32, Usage>);

impl Users {
    pub(super) const fn new() -> Self {
        Self(BTreeMap::new())
    }

    /// Adds a connection. Returns whether the quota allows it; the connection counts until it
    /// leaves in either case.
    pub(super) fn connect(&mut self, uid: u32, policy: &Policy) -> bool {
        let usage = self.0.entry(uid).or_default();
        usage.greeting += 1;
        usage.greeting <= policy.greetings_per_user
    }

    pub(super) fn greet(&mut self, uid: u32) {
        let usage = self.0.entry(uid).or_default();
        usage.greeting = usage.greeting.saturating_sub(1);
        usage.welcomed += 1;
    }

    pub(super) fn leave(&mut self, uid: u32, welcomed: bool, interfaces: usize) {
        let usage = self.0.entry(uid).or_default();
        let count = if welcomed {
            &mut usage.welcomed
        } else {
            &mut usage.greeting
        };
        *count = count.saturating_sub(1);
        self.withdraw(uid, interfaces);
    }

    pub(super) fn declare(&mut self, uid: u32) {
        self.0.entry(uid).or_default().interfaces += 1;
    }

    pub(super) fn withdraw(&mut self, uid: u32, interfaces: usize) {
        let usage = self.0.entry(uid).or_default();
        usage.interfaces = usage.interfaces.saturating_sub(interfaces);
        if *usage == Usage::default() {
            self.0.remove(&uid);
        }
    }

    pub(super) fn refuse_session(&self, uid: u32, policy: &Policy) -> Result<(), Refusal> {
        let welcomed = self.0.get(&uid).map_or(0, |usage| usage.welcomed);
        within(
            policy.sessions_per_user,
            welcomed + 1,
            Quota::SessionsPerUser,
        )
    }

    pub(super) fn refuse_interface(&self, uid: u32, policy: &Policy) -> Result<(), Refusal> {
        let interfaces = self.0.get(&uid).map_or(0, |usage| usage.interfaces);
        let limit = policy.interfaces_per_user;
        within(limit, interfaces + 1, Quota::InterfacesPerUser)
    }

    /// Whether every count equals a recount.
    pub(super) fn are<'a>(&self, sessions: impl Iterator<Item = &'a Session>) -> bool {
        let mut recount: BTreeMap<u32, Usage> = BTreeMap::new();
        for session in sessions {
            let usage = recount.entry(session.credentials().uid).or_default();
            match session.node() {
                Some(record) => {
                    usage.welcomed += 1;
                    usage.interfaces += record.interfaces();
                }
                None => usage.greeting += 1,
            }
        }
        recount == self.0
    }
}
