//! The connections, sessions and interfaces that each user and each process has, for their quotas.

#[cfg(any(kani, test))]
mod proofs;

use crate::control::{Limit, Limits};
use alloc::collections::BTreeMap;

use super::{Credentials, quota::within, session::Session};
use crate::{Quota, Refusal};

/// The usage of one user or process.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
struct Usage {
    greeting: usize,
    welcomed: usize,
    interfaces: usize,
}

/// A user, or a process of a user. A process has a share of its user's quotas, so that it cannot
/// use them up alone.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
enum Owner {
    User(u32),
    Process(u32, i32),
}

impl Owner {
    /// The owners that a connection counts for. The kernel tells no number of a process that this
    /// one cannot see: such processes are not told apart, and have no share.
    //= SM2-SES-010
    fn of(who: Credentials) -> impl Iterator<Item = Self> {
        let process = (who.pid > 0).then_some(Self::Process(who.uid, who.pid));
        process.into_iter().chain([Self::User(who.uid)])
    }

    const fn greetings(self, limits: &Limits) -> usize {
        match self {
            Self::User(_) => limits.count(Limit::GreetingsPerUser),
            Self::Process(..) => limits.count(Limit::GreetingsPerProcess),
        }
    }

    const fn sessions(self, limits: &Limits) -> (usize, Quota) {
        match self {
            Self::User(_) => (limits.count(Limit::SessionsPerUser), Quota::SessionsPerUser),
            Self::Process(..) => (
                limits.count(Limit::SessionsPerProcess),
                Quota::SessionsPerProcess,
            ),
        }
    }

    const fn interfaces(self, limits: &Limits) -> (usize, Quota) {
        match self {
            Self::User(_) => (
                limits.count(Limit::InterfacesPerUser),
                Quota::InterfacesPerUser,
            ),
            Self::Process(..) => (
                limits.count(Limit::InterfacesPerProcess),
                Quota::InterfacesPerProcess,
            ),
        }
    }
}

/// The usage of each user and process. One without any has no entry.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub(super) struct Users(BTreeMap<Owner, Usage>);

impl Users {
    pub(super) const fn new() -> Self {
        Self(BTreeMap::new())
    }

    /// Adds a connection. Returns whether the quotas allow it; the connection counts until it
    /// leaves in either case.
    pub(super) fn connect(&mut self, who: Credentials, limits: &Limits) -> bool {
        let mut fits = true;
        for owner in Owner::of(who) {
            let usage = self.0.entry(owner).or_default();
            usage.greeting += 1;
            fits &= usage.greeting <= owner.greetings(limits);
        }
        fits
    }

    pub(super) fn greet(&mut self, who: Credentials) {
        for owner in Owner::of(who) {
            let usage = self.0.entry(owner).or_default();
            usage.greeting = usage.greeting.saturating_sub(1);
            usage.welcomed += 1;
        }
    }

    pub(super) fn leave(&mut self, who: Credentials, welcomed: bool, interfaces: usize) {
        for owner in Owner::of(who) {
            let usage = self.0.entry(owner).or_default();
            let count = if welcomed {
                &mut usage.welcomed
            } else {
                &mut usage.greeting
            };
            *count = count.saturating_sub(1);
        }
        self.withdraw(who, interfaces);
    }

    pub(super) fn declare(&mut self, who: Credentials) {
        for owner in Owner::of(who) {
            self.0.entry(owner).or_default().interfaces += 1;
        }
    }

    pub(super) fn withdraw(&mut self, who: Credentials, interfaces: usize) {
        for owner in Owner::of(who) {
            let usage = self.0.entry(owner).or_default();
            usage.interfaces = usage.interfaces.saturating_sub(interfaces);
            if *usage == Usage::default() {
                self.0.remove(&owner);
            }
        }
    }

    //= SM2-IFC-006, SM2-SES-010
    pub(super) fn refuse_session(&self, who: Credentials, limits: &Limits) -> Result<(), Refusal> {
        Owner::of(who).try_for_each(|owner| {
            let (limit, quota) = owner.sessions(limits);
            within(limit, self.usage(owner).welcomed + 1, quota)
        })
    }

    //= SM2-IFC-006, SM2-SES-010
    pub(super) fn refuse_interface(
        &self,
        who: Credentials,
        limits: &Limits,
    ) -> Result<(), Refusal> {
        Owner::of(who).try_for_each(|owner| {
            let (limit, quota) = owner.interfaces(limits);
            within(limit, self.usage(owner).interfaces + 1, quota)
        })
    }

    fn usage(&self, owner: Owner) -> Usage {
        self.0.get(&owner).copied().unwrap_or_default()
    }

    /// Whether every count equals a recount.
    pub(super) fn are<'a>(&self, sessions: impl Iterator<Item = &'a Session>) -> bool {
        let mut recount: BTreeMap<Owner, Usage> = BTreeMap::new();
        for session in sessions {
            for owner in Owner::of(session.credentials()) {
                let usage = recount.entry(owner).or_default();
                match session.node() {
                    Some(record) => {
                        usage.welcomed += 1;
                        usage.interfaces += record.interfaces();
                    }
                    None => usage.greeting += 1,
                }
            }
        }
        recount == self.0
    }
}
