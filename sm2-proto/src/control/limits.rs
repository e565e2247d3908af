//! The limits of a Manager: what each one is, where it is set, and which values it takes.
//!
//! Each limit is one row of a table: its name, option, unit and range. The command line, the checks, the item *domain*,
//! `sm2 doctor`, `sm2 snapshot` and a page of the book are made from the table, so a new limit is configurable and
//! visible without further code. The machine works with any values. Programs check the values before the machine
//! starts, because a wrong value is a mistake of a person, who needs the option's name and its range.

use core::{fmt, ops::RangeInclusive};

use serde::{Deserialize, Serialize};

use crate::{
    limits::{DATAGRAM_MAX, LINKS_MAX},
    text::Counted,
};

/// The longest time that a limit takes, in milliseconds: a day.
const LONGEST_MS: u64 = 86_400_000;

/// A limit of a Manager (SPEC section 2).
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Limit {
    /// Welcomed sessions of one user.
    SessionsPerUser,
    /// Interfaces of one session.
    InterfacesPerSession,
    /// Interfaces of all sessions of one user.
    InterfacesPerUser,
    /// Ends of links of one session.
    LinksPerSession,
    /// Welcomed sessions of one process.
    SessionsPerProcess,
    /// Interfaces of all sessions of one process.
    InterfacesPerProcess,
    /// Connections of one user that are not welcomed yet.
    GreetingsPerUser,
    /// Connections of one process that are not welcomed yet.
    GreetingsPerProcess,
    /// The time within which a connection has to become ready.
    Greeting,
    /// The time for which a claim waits for its counterpart.
    Recovery,
    /// The time within which a node has to confirm that it ended what a new access policy denies.
    Confirmation,
    /// Bytes that are queued for a node that does not read.
    QueueBytes,
    /// Bytes of the schema texts of one session.
    SchemaBytesPerSession,
    /// Refusals of one session that are remembered.
    RefusalsPerSession,
    /// Unlinked pairs that are remembered, per session of the offering side.
    UnlinkedPerSession,
    /// Changes of the domain that are remembered.
    ChangesRemembered,
    /// LINKs that a session is sent before its socket has taken all of them.
    LinksInFlight,
    /// The work that is done for one input before other sessions are served.
    WorkPerTurn,
}

/// The unit of a limit's value.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Unit {
    /// A number of things.
    Count,
    /// Milliseconds. The option of a limit takes whole seconds.
    Milliseconds,
    /// Bytes.
    Bytes,
}

/// The fixed properties of a limit.
struct Row {
    name: &'static str,
    option: &'static str,
    unit: Unit,
    range: RangeInclusive<u64>,
    /// The end of the text of [`Limit`].
    meaning: &'static str,
}

const fn counts(name: &'static str, option: &'static str, most: u64, meaning: &'static str) -> Row {
    Row {
        name,
        option,
        unit: Unit::Count,
        range: 1..=most,
        meaning,
    }
}

const fn lasts(name: &'static str, option: &'static str, meaning: &'static str) -> Row {
    Row {
        name,
        option,
        unit: Unit::Milliseconds,
        range: 1..=LONGEST_MS,
        meaning,
    }
}

const fn occupies(
    name: &'static str,
    option: &'static str,
    least: u64,
    meaning: &'static str,
) -> Row {
    Row {
        name,
        option,
        unit: Unit::Bytes,
        range: least..=MOST,
        meaning,
    }
}

/// The greatest value that a frame can carry.
const MOST: u64 = u32::MAX as u64;

impl Limit {
    /// The number of limits.
    pub const COUNT: usize = 18;

    /// Every limit, in the order of the fields of [`Limits`].
    pub const ALL: [Self; Self::COUNT] = [
        Self::SessionsPerUser,
        Self::InterfacesPerSession,
        Self::InterfacesPerUser,
        Self::LinksPerSession,
        Self::SessionsPerProcess,
        Self::InterfacesPerProcess,
        Self::GreetingsPerUser,
        Self::GreetingsPerProcess,
        Self::Greeting,
        Self::Recovery,
        Self::Confirmation,
        Self::QueueBytes,
        Self::SchemaBytesPerSession,
        Self::RefusalsPerSession,
        Self::UnlinkedPerSession,
        Self::ChangesRemembered,
        Self::LinksInFlight,
        Self::WorkPerTurn,
    ];

    /// The table of all limits. Every property of a limit is stated here, and nowhere else.
    #[rustfmt::skip]
    const fn row(self) -> Row {
        match self {
            Self::SessionsPerUser => counts("sessions_per_user", "--max-sessions", MOST,
                "welcomed sessions of one user"),
            Self::InterfacesPerSession => counts("interfaces_per_session", "--max-interfaces", MOST,
                "interfaces of one session"),
            Self::InterfacesPerUser => counts("interfaces_per_user", "--max-user-interfaces", MOST,
                "interfaces of all sessions of one user"),
            Self::LinksPerSession => counts("links_per_session", "--max-links", LINKS_MAX as u64,
                "ends of links of one session"),
            Self::SessionsPerProcess => counts("sessions_per_process", "--max-process-sessions", MOST,
                "welcomed sessions of one process"),
            Self::InterfacesPerProcess => counts("interfaces_per_process", "--max-process-interfaces", MOST,
                "interfaces of all sessions of one process"),
            Self::GreetingsPerUser => counts("greetings_per_user", "--max-greetings", MOST,
                "connections of one user that are not welcomed yet"),
            Self::GreetingsPerProcess => counts("greetings_per_process", "--max-process-greetings", MOST,
                "connections of one process that are not welcomed yet"),
            Self::Greeting => lasts("greeting_ms", "--greeting-timeout",
                "within which a connection has to become ready"),
            Self::Recovery => lasts("recovery_ms", "--recovery-timeout",
                "for which a claim waits for its counterpart"),
            Self::Confirmation => lasts("confirmation_ms", "--confirmation-timeout",
                "within which a node has to confirm that it ended what a new access policy denies"),
            Self::QueueBytes => occupies("queue_bytes", "--max-queue-bytes", 2 * DATAGRAM_MAX as u64,
                "frames that wait for a node that does not read; each counts 32 bytes more than its length"),
            Self::SchemaBytesPerSession => occupies("schema_bytes_per_session", "--max-schema-bytes", 1,
                "schema texts of one session, with the names of their types"),
            Self::RefusalsPerSession => counts("refusals_per_session", "--max-refusals", MOST,
                "refused interfaces of one session that are remembered"),
            Self::UnlinkedPerSession => counts("unlinked_per_session", "--max-unlinked", MOST,
                "unlinked pairs that are remembered, per session of the publisher or server"),
            Self::ChangesRemembered => counts("changes_remembered", "--max-changes", MOST,
                "changes of the domain that are remembered"),
            Self::LinksInFlight => counts("links_in_flight", "--max-links-in-flight", MOST,
                "LINKs sent to one session before its socket has taken all of them"),
            Self::WorkPerTurn => counts("work_per_turn", "--max-work-per-turn", MOST,
                "units of work for one input before other sessions are served: a link that is made costs 64, one that \
                 ends 16, a comparison of two interfaces 1"),
        }
    }

    /// The name in JSON, such as `sessions_per_user`. The unit is its end where it is not a count.
    #[must_use]
    pub const fn name(self) -> &'static str {
        self.row().name
    }

    /// The option of `sm2-manager` that sets the limit.
    #[must_use]
    pub const fn option(self) -> &'static str {
        self.row().option
    }

    /// The unit of the values.
    #[must_use]
    pub const fn unit(self) -> Unit {
        self.row().unit
    }

    /// The values that a Manager accepts.
    #[must_use]
    pub const fn range(self) -> RangeInclusive<u64> {
        self.row().range
    }

    /// The limit that this one may not exceed, as what it counts is a part of what the other one counts.
    #[must_use]
    pub const fn whole(self) -> Option<Self> {
        match self {
            Self::GreetingsPerProcess => Some(Self::GreetingsPerUser),
            Self::SessionsPerProcess => Some(Self::SessionsPerUser),
            Self::InterfacesPerProcess => Some(Self::InterfacesPerUser),
            Self::InterfacesPerSession => Some(Self::InterfacesPerProcess),
            _ => None,
        }
    }

    /// A value of this limit with its unit: `8192`, `2 s`, `1048576 bytes`.
    #[must_use]
    pub const fn show(self, value: u64) -> Shown {
        Shown {
            unit: self.unit(),
            value,
        }
    }
}

/// `maximum number of interfaces of one session`, `time within which a connection has to become ready`.
impl fmt::Display for Limit {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let row = self.row();
        f.write_str(match row.unit {
            Unit::Count => "maximum number of ",
            Unit::Milliseconds => "time ",
            Unit::Bytes => "maximum number of bytes of ",
        })?;
        f.write_str(row.meaning)
    }
}

/// A value of a limit, to be displayed with its unit.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Shown {
    unit: Unit,
    value: u64,
}

impl fmt::Display for Shown {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let value = self.value;
        match self.unit {
            Unit::Count => write!(f, "{value}"),
            Unit::Milliseconds if value.is_multiple_of(1_000) => write!(f, "{} s", value / 1_000),
            Unit::Milliseconds => write!(f, "{value} ms"),
            Unit::Bytes => Counted::new(value, "byte").fmt(f),
        }
    }
}

/// The reason why a Manager does not accept its limits.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum LimitError {
    /// A value is outside of the range of its limit.
    #[error(
        "{} is {}: give {} to {}",
        .limit.option(),
        .limit.show(*.value),
        .limit.show(*.limit.range().start()),
        .limit.show(*.limit.range().end())
    )]
    OutOfRange {
        /// The limit.
        limit: Limit,
        /// Its value.
        value: u64,
    },
    /// A value exceeds that of the [`whole`](Limit::whole): the limit could never be reached.
    #[error(
        "{} is {}: give {} to {}, the value of {}, or raise that one",
        .limit.option(),
        .limit.show(*.value),
        .limit.show(*.limit.range().start()),
        .limit.show(*.most),
        .whole.option()
    )]
    AboveWhole {
        /// The limit.
        limit: Limit,
        /// Its value.
        value: u64,
        /// The limit that it exceeds.
        whole: Limit,
        /// The value of that one.
        most: u64,
    },
}

/// The public part of the operator's policy: the limits in force at a Manager, and which links are sealed. The
/// order of fields is the wire format.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub struct Limits {
    /// Welcomed sessions of one user.
    pub sessions_per_user: u32,
    /// Interfaces of one session.
    pub interfaces_per_session: u32,
    /// Interfaces of all sessions of one user.
    pub interfaces_per_user: u32,
    /// Ends of links of one session.
    pub links_per_session: u32,
    /// Welcomed sessions of one process.
    pub sessions_per_process: u32,
    /// Interfaces of all sessions of one process.
    pub interfaces_per_process: u32,
    /// Connections of one user that are not welcomed yet.
    pub greetings_per_user: u32,
    /// Connections of one process that are not welcomed yet.
    pub greetings_per_process: u32,
    /// The time within which a connection has to become ready, in milliseconds.
    pub greeting_ms: u32,
    /// The time for which a claim waits for its counterpart, in milliseconds.
    pub recovery_ms: u32,
    /// The time within which a node has to confirm that it ended what a new access policy denies, in milliseconds.
    pub confirmation_ms: u32,
    /// Bytes that are queued for a node that does not read.
    pub queue_bytes: u32,
    /// Bytes of the schema texts of one session.
    pub schema_bytes_per_session: u32,
    /// Refusals of one session that are remembered.
    pub refusals_per_session: u32,
    /// Unlinked pairs that are remembered, per session of the offering side.
    pub unlinked_per_session: u32,
    /// Changes of the domain that are remembered.
    pub changes_remembered: u32,
    /// LINKs that a session is sent before its socket has taken all of them.
    pub links_in_flight: u32,
    /// The work that is done for one input before other sessions are served.
    pub work_per_turn: u32,
    /// Whether every link of the domain is sealed.
    pub seal_all: bool,
    /// Whether links between different users may be unsealed.
    pub waive_user_boundary: bool,
}

impl Limits {
    /// The value of a limit, in the unit of [`Limit::unit`].
    #[must_use]
    pub const fn of(&self, limit: Limit) -> u32 {
        match limit {
            Limit::SessionsPerUser => self.sessions_per_user,
            Limit::InterfacesPerSession => self.interfaces_per_session,
            Limit::InterfacesPerUser => self.interfaces_per_user,
            Limit::LinksPerSession => self.links_per_session,
            Limit::SessionsPerProcess => self.sessions_per_process,
            Limit::InterfacesPerProcess => self.interfaces_per_process,
            Limit::GreetingsPerUser => self.greetings_per_user,
            Limit::GreetingsPerProcess => self.greetings_per_process,
            Limit::Greeting => self.greeting_ms,
            Limit::Recovery => self.recovery_ms,
            Limit::Confirmation => self.confirmation_ms,
            Limit::QueueBytes => self.queue_bytes,
            Limit::SchemaBytesPerSession => self.schema_bytes_per_session,
            Limit::RefusalsPerSession => self.refusals_per_session,
            Limit::UnlinkedPerSession => self.unlinked_per_session,
            Limit::ChangesRemembered => self.changes_remembered,
            Limit::LinksInFlight => self.links_in_flight,
            Limit::WorkPerTurn => self.work_per_turn,
        }
    }
}

#[cfg(test)]
mod tests {
    use alloc::string::ToString as _;

    use super::*;

    #[test]
    fn names_and_options_differ() {
        for (at, one) in Limit::ALL.into_iter().enumerate() {
            for other in &Limit::ALL[..at] {
                assert_ne!(one.name(), other.name());
                assert_ne!(one.option(), other.option());
            }
            assert!(*one.range().end() <= MOST);
        }
    }

    #[test]
    fn values_are_shown_with_their_units() {
        for (limit, value, text) in [
            (Limit::LinksInFlight, 256, "256"),
            (Limit::Greeting, 2_000, "2 s"),
            (Limit::Greeting, 1_500, "1500 ms"),
            (Limit::QueueBytes, 131_072, "131072 bytes"),
            (Limit::SchemaBytesPerSession, 1, "1 byte"),
        ] {
            assert_eq!(limit.show(value).to_string(), text);
        }
    }
}
