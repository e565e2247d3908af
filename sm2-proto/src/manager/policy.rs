//! The operator's policy: quotas per user and per session, and when to seal.

use core::time::Duration;

use crate::{
    Quota, Refusal,
    control::{Limit, LimitError, Limits},
    limits::LINKS_MAX,
};

/// The Manager's own limits (SPEC section 2) and its policy on integrity.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct Policy {
    /// The time within which a connection has to become ready: its HELLO is granted and its links
    /// are claimed.
    pub greeting: Duration,
    /// The time for which a claim waits for its counterpart after CLAIMED.
    pub recovery: Duration,
    /// The time within which nodes have to confirm that they ended what a new access policy denies.
    pub confirmation: Duration,
    /// Bytes that the driver queues for a session whose node does not read. Each queued frame counts 32 bytes
    /// more than its length.
    pub queue_bytes: usize,
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
            queue_bytes: 1 << 20,
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

    /// The part of the policy that every node may know. A value that a frame cannot carry is shown as the
    /// greatest one that it can.
    #[must_use]
    //= SM2-WCH-005
    pub fn limits(&self) -> Limits {
        let shown = |limit| count(self.value(limit));
        Limits {
            sessions_per_user: shown(Limit::SessionsPerUser),
            interfaces_per_session: shown(Limit::InterfacesPerSession),
            interfaces_per_user: shown(Limit::InterfacesPerUser),
            links_per_session: count(self.links_per_session()),
            sessions_per_process: shown(Limit::SessionsPerProcess),
            interfaces_per_process: shown(Limit::InterfacesPerProcess),
            greetings_per_user: shown(Limit::GreetingsPerUser),
            greetings_per_process: shown(Limit::GreetingsPerProcess),
            greeting_ms: shown(Limit::Greeting),
            recovery_ms: shown(Limit::Recovery),
            confirmation_ms: shown(Limit::Confirmation),
            queue_bytes: shown(Limit::QueueBytes),
            schema_bytes_per_session: shown(Limit::SchemaBytesPerSession),
            refusals_per_session: shown(Limit::RefusalsPerSession),
            unlinked_per_session: shown(Limit::UnlinkedPerSession),
            changes_remembered: shown(Limit::ChangesRemembered),
            links_in_flight: shown(Limit::LinksInFlight),
            work_per_turn: shown(Limit::WorkPerTurn),
            seal_all: self.seal_all,
            waive_user_boundary: self.waive_user_boundary,
        }
    }

    /// Checks that every limit is within its range, and that no limit of a part exceeds that of the whole.
    /// A Manager works with any policy. A program that takes one from its user calls this function first.
    ///
    /// # Errors
    ///
    /// The [`LimitError`] of the first wrong limit.
    pub fn check(&self) -> Result<(), LimitError> {
        for limit in Limit::ALL {
            let value = self.value(limit);
            if !limit.range().contains(&value) {
                return Err(LimitError::OutOfRange { limit, value });
            }
        }
        for limit in Limit::ALL {
            let Some(whole) = limit.whole() else {
                continue;
            };
            let (value, most) = (self.value(limit), self.value(whole));
            if value > most {
                return Err(LimitError::AboveWhole {
                    limit,
                    value,
                    whole,
                    most,
                });
            }
        }
        Ok(())
    }

    /// The value of a limit, in the unit of [`Limit::unit`].
    #[must_use]
    pub fn value(&self, limit: Limit) -> u64 {
        let number = match limit {
            Limit::Greeting => return millis(self.greeting),
            Limit::Recovery => return millis(self.recovery),
            Limit::Confirmation => return millis(self.confirmation),
            Limit::SessionsPerUser => self.sessions_per_user,
            Limit::InterfacesPerSession => self.interfaces_per_session,
            Limit::InterfacesPerUser => self.interfaces_per_user,
            Limit::LinksPerSession => self.links_per_session,
            Limit::SessionsPerProcess => self.sessions_per_process,
            Limit::InterfacesPerProcess => self.interfaces_per_process,
            Limit::GreetingsPerUser => self.greetings_per_user,
            Limit::GreetingsPerProcess => self.greetings_per_process,
            Limit::QueueBytes => self.queue_bytes,
            Limit::SchemaBytesPerSession => self.schema_bytes_per_session,
            Limit::RefusalsPerSession => self.refusals_per_session,
            Limit::UnlinkedPerSession => self.unlinked_per_session,
            Limit::ChangesRemembered => self.changes_remembered,
            Limit::LinksInFlight => self.links_in_flight,
            Limit::WorkPerTurn => self.work_per_turn,
        };
        number as u64
    }

    /// Sets a limit to a value in the unit of [`Limit::unit`].
    pub fn set(&mut self, limit: Limit, value: u64) {
        let number = match limit {
            Limit::Greeting => return self.greeting = Duration::from_millis(value),
            Limit::Recovery => return self.recovery = Duration::from_millis(value),
            Limit::Confirmation => return self.confirmation = Duration::from_millis(value),
            Limit::SessionsPerUser => &mut self.sessions_per_user,
            Limit::InterfacesPerSession => &mut self.interfaces_per_session,
            Limit::InterfacesPerUser => &mut self.interfaces_per_user,
            Limit::LinksPerSession => &mut self.links_per_session,
            Limit::SessionsPerProcess => &mut self.sessions_per_process,
            Limit::InterfacesPerProcess => &mut self.interfaces_per_process,
            Limit::GreetingsPerUser => &mut self.greetings_per_user,
            Limit::GreetingsPerProcess => &mut self.greetings_per_process,
            Limit::QueueBytes => &mut self.queue_bytes,
            Limit::SchemaBytesPerSession => &mut self.schema_bytes_per_session,
            Limit::RefusalsPerSession => &mut self.refusals_per_session,
            Limit::UnlinkedPerSession => &mut self.unlinked_per_session,
            Limit::ChangesRemembered => &mut self.changes_remembered,
            Limit::LinksInFlight => &mut self.links_in_flight,
            Limit::WorkPerTurn => &mut self.work_per_turn,
        };
        *number = usize::try_from(value).unwrap_or(usize::MAX);
    }
}

fn millis(time: Duration) -> u64 {
    u64::try_from(time.as_millis()).unwrap_or(u64::MAX)
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
pub(super) fn count(count: impl TryInto<u32>) -> u32 {
    count.try_into().unwrap_or(u32::MAX)
}
