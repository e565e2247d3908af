//! The operator's policy: quotas per user and per session, and when to seal.

use core::time::Duration;

use crate::{Quota, Refusal, control::Limits, limits::LINKS_MAX};

/// The Manager's own limits (SPEC section 2) and its policy on integrity.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct Policy {
    /// The time within which a connection has to become ready: its HELLO is granted and its links
    /// are claimed.
    pub greeting: Duration,
    /// The time for which a claim waits for its counterpart after CLAIMED.
    pub recovery: Duration,
    /// The time within which nodes have to confirm the end of links that a new access policy denies.
    pub confirmation: Duration,
    /// Connections of one user that are not welcomed yet.
    pub greetings_per_user: usize,
    /// Connections of one process that are not welcomed yet.
    pub greetings_per_process: usize,
    /// Welcomed sessions of one user.
    pub sessions_per_user: usize,
    /// Welcomed sessions of one process.
    pub sessions_per_process: usize,
    /// Interfaces of one session.
    pub interfaces_per_session: usize,
    /// Interfaces of all sessions of one user.
    pub interfaces_per_user: usize,
    /// Interfaces of all sessions of one process.
    pub interfaces_per_process: usize,
    /// Ends of links of one session; at most [`LINKS_MAX`] count.
    pub links_per_session: usize,
    /// Schema texts of one session, with the names of their types, in bytes.
    pub schema_bytes_per_session: usize,
    /// Refusals of one session that are remembered.
    pub refusals_per_session: usize,
    /// Unlinked pairs that are remembered, per session of the offering side.
    pub unlinked_per_session: usize,
    /// Changes of the domain that are remembered.
    pub changes_remembered: usize,
    /// LINKs that a session is sent before its socket has taken all of them; 0 counts as 1.
    pub links_in_flight: usize,
    /// The work that is done for one input before other sessions are served, in units of about
    /// 0.3 µs: a link that is made costs 64, one that ends 16, and a comparison of two interfaces 1.
    /// The first part of a DECLARE may cost four times as much.
    pub work_per_turn: usize,
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
            confirmation: Duration::from_secs(5),
            greetings_per_user: 256,
            greetings_per_process: 64,
            sessions_per_user: 1_024,
            sessions_per_process: 512,
            interfaces_per_session: 1_024,
            interfaces_per_user: 16_384,
            interfaces_per_process: 8_192,
            links_per_session: 8_192,
            schema_bytes_per_session: 262_144,
            refusals_per_session: 16,
            unlinked_per_session: 256,
            changes_remembered: 4_096,
            links_in_flight: 256,
            work_per_turn: 512,
            seal_all: false,
            waive_user_boundary: false,
        }
    }
}

impl Policy {
    /// Whether a link is sealed even if neither side asks for it.
    //= SM2-MAT-003
    pub(super) const fn seals(&self, same_user: bool) -> bool {
        self.seal_all || (!same_user && !self.waive_user_boundary)
    }

    pub(super) fn links_per_session(&self) -> usize {
        self.links_per_session.min(LINKS_MAX)
    }

    //= SM2-LNK-007
    pub(super) const fn links_in_flight(&self) -> usize {
        if self.links_in_flight == 0 {
            1
        } else {
            self.links_in_flight
        }
    }

    /// The part of the policy that every node may know.
    pub(super) fn limits(&self) -> Limits {
        Limits {
            sessions_per_user: count(self.sessions_per_user),
            interfaces_per_session: count(self.interfaces_per_session),
            interfaces_per_user: count(self.interfaces_per_user),
            links_per_session: count(self.links_per_session()),
            sessions_per_process: count(self.sessions_per_process),
            interfaces_per_process: count(self.interfaces_per_process),
            seal_all: self.seal_all,
            waive_user_boundary: self.waive_user_boundary,
        }
    }
}

/// Refuses a count above `limit`.
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

/// A count as a frame carries it.
pub(super) fn count(count: usize) -> u32 {
    u32::try_from(count).unwrap_or(u32::MAX)
}
