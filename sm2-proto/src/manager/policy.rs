//! What the operator allows: quotas per user and per session, and when to seal.

#[cfg(any(kani, test))]
mod proofs;

use alloc::collections::BTreeMap;
use core::time::Duration;

use super::session::Session;
use crate::{Quota, Refusal, control::Limits, limits::LINKS_MAX};

/// The Manager's own limits (SPEC section 2) and its policy on integrity.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct Policy {
    /// How long a connection may take until it is ready: its HELLO is granted, and what
    /// it brought along is claimed.
    pub greeting: Duration,
    /// How long a claim waits for its counterpart after CLAIMED.
    pub recovery: Duration,
    /// Connections of one user that are not welcomed.
    pub greetings_per_user: usize,
    /// Welcomed sessions of one user.
    pub sessions_per_user: usize,
    /// Interfaces of one session.
    pub interfaces_per_session: usize,
    /// Interfaces of all sessions of one user.
    pub interfaces_per_user: usize,
    /// Ends of links of one session; more than [`LINKS_MAX`] count as that.
    pub links_per_session: usize,
    /// Schema texts of one session, with the names of their types, in bytes.
    pub schema_bytes_per_session: usize,
    /// Refusals of one session that are remembered.
    pub refusals_per_session: usize,
    /// Unlinked pairs that are remembered, per session of the offering side.
    pub unlinked_per_session: usize,
    /// Changes of the domain that are remembered.
    pub changes_remembered: usize,
    /// LINKs that a session is sent before its socket has taken all of them; none counts as one.
    pub links_ahead: usize,
    /// How many pairs of a session that has claimed all it has are looked at for one input.
    pub pairs_per_turn: usize,
    /// Whether every link of the domain is sealed.
    pub seal_all: bool,
    /// Whether links between different users may be unsealed.
    pub waive_user_boundary: bool,
}

impl Default for Policy {
    fn default() -> Self {
        Self {
            greeting: Duration::from_secs(2),
            recovery: Duration::from_secs(5),
            greetings_per_user: 256,
            sessions_per_user: 1_024,
            interfaces_per_session: 1_024,
            interfaces_per_user: 16_384,
            links_per_session: 8_192,
            schema_bytes_per_session: 262_144,
            refusals_per_session: 16,
            unlinked_per_session: 256,
            changes_remembered: 4_096,
            links_ahead: 256,
            pairs_per_turn: 256,
            seal_all: false,
            waive_user_boundary: false,
        }
    }
}

impl Policy {
    /// Whether a link is sealed whatever its two sides want.
    //= SM2-MAT-003
    pub(super) const fn seals(&self, same_user: bool) -> bool {
        self.seal_all || (!same_user && !self.waive_user_boundary)
    }

    pub(super) fn links_per_session(&self) -> usize {
        self.links_per_session.min(LINKS_MAX)
    }

    //= SM2-LNK-007
    pub(super) const fn links_ahead(&self) -> usize {
        if self.links_ahead == 0 {
            1
        } else {
            self.links_ahead
        }
    }

    /// What of this everybody may know.
    pub(super) fn limits(&self) -> Limits {
        Limits {
            sessions_per_user: count(self.sessions_per_user),
            interfaces_per_session: count(self.interfaces_per_session),
            interfaces_per_user: count(self.interfaces_per_user),
            links_per_session: count(self.links_per_session()),
            seal_all: self.seal_all,
            waive_user_boundary: self.waive_user_boundary,
        }
    }
}

/// What one user has.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
struct Usage {
    greeting: usize,
    welcomed: usize,
    interfaces: usize,
}

/// What each user has. A user with nothing has no entry.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub(super) struct Users(BTreeMap<u32, Usage>);

impl Users {
    pub(super) const fn new() -> Self {
        Self(BTreeMap::new())
    }

    /// A connection came. Whether the user may have it; it counts until it
    /// leaves in any case.
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

    /// Whether every charge is what a recount says.
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

/// More than `limit` is refused.
//= SM2-IFC-006
pub(super) fn within(limit: usize, wanted: usize, quota: Quota) -> Result<(), Refusal> {
    if wanted <= limit {
        return Ok(());
    }
    Err(Refusal::Quota {
        quota,
        limit: count(limit),
    })
}

/// As it goes on the wire.
pub(super) fn count(count: usize) -> u32 {
    u32::try_from(count).unwrap_or(u32::MAX)
}
