//! The limits of a Manager: what each one is, and which values it takes.
//!
//! Each limit is one row of a table: its name, unit, range, default and meaning, and what happens beyond it. The
//! options of the command line, the checks, the item *domain*, `sm2 doctor`, `sm2 snapshot` and the second table of
//! SPEC section 2 are made from the table, so a new limit is configurable and visible without further code. The
//! machine works with any values. Programs check the values before the machine starts, because a wrong value is a
//! mistake of a person, who needs its range.

use core::{fmt, ops::RangeInclusive, time::Duration};

use crate::{
    limits::{DATAGRAM_MAX, LINKS_MAX},
    text::Counted,
};

/// The greatest value that a frame can carry.
const MOST: u32 = u32::MAX;
/// The longest time that a limit takes, in milliseconds: a day.
const LONGEST_MS: u32 = 86_400_000;
/// The smallest queue, in bytes: two datagrams.
const SHORTEST_QUEUE_BYTES: u32 = 2 * DATAGRAM_MAX as u32;

/// The unit of a limit's value.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Unit {
    /// A number of things.
    Count,
    /// Milliseconds.
    Milliseconds,
    /// Bytes.
    Bytes,
}

/// The fixed properties of a limit.
struct Row {
    name: &'static str,
    unit: Unit,
    range: RangeInclusive<u32>,
    default: u32,
    /// The end of the text of [`Limit`].
    meaning: &'static str,
    beyond: &'static str,
}

/// Defines [`Limit`] from its table. The order of the rows is that of the limits in a frame.
macro_rules! limits {
    ($($limit:ident $name:literal $unit:ident $least:tt..=$most:tt $default:literal $meaning:literal
       $beyond:literal)*) => {
        /// A limit of a Manager (SPEC section 2).
        #[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
        pub enum Limit {
            $(
                #[doc = concat!("`", $name, "`: ", $meaning)]
                $limit,
            )*
        }

        impl Limit {
            /// Every limit, in the order in which a frame carries them.
            pub const ALL: [Self; Self::COUNT] = [$(Self::$limit,)*];
            /// The number of limits.
            pub const COUNT: usize = [$(Self::$limit,)*].len();

            const fn row(self) -> Row {
                match self {
                    $(
                        Self::$limit => Row {
                            name: $name,
                            unit: Unit::$unit,
                            range: $least..=$most,
                            default: $default,
                            meaning: $meaning,
                            beyond: $beyond,
                        },
                    )*
                }
            }
        }
    };
}

limits! {
    SessionsPerUser "sessions_per_user" Count 1..=MOST 1_024
        "welcomed sessions of one user"
        "refusal `quota`"
    InterfacesPerSession "interfaces_per_session" Count 1..=MOST 1_024
        "interfaces of one session"
        "refusal `quota`"
    InterfacesPerUser "interfaces_per_user" Count 1..=MOST 16_384
        "interfaces of all sessions of one user"
        "refusal `quota`"
    LinksPerSession "links_per_session" Count 1..=(LINKS_MAX as u32) 8_192
        "ends of links of one session"
        "refusal `quota`, or the pair is not linked"
    SessionsPerProcess "sessions_per_process" Count 1..=MOST 512
        "welcomed sessions of one process"
        "refusal `quota`"
    InterfacesPerProcess "interfaces_per_process" Count 1..=MOST 8_192
        "interfaces of all sessions of one process"
        "refusal `quota`"
    GreetingsPerUser "greetings_per_user" Count 1..=MOST 256
        "connections of one user that are not welcomed yet"
        "close code `resources`"
    GreetingsPerProcess "greetings_per_process" Count 1..=MOST 64
        "connections of one process that are not welcomed yet"
        "close code `resources`"
    Greeting "greeting_ms" Milliseconds 1..=LONGEST_MS 2_000
        "within which a connection has to become ready: its HELLO is granted and its links are claimed"
        "close code `greeting-timeout`"
    Recovery "recovery_ms" Milliseconds 1..=LONGEST_MS 5_000
        "that a claim waits for its counterpart"
        "UNLINK `peer-gone`"
    Confirmation "confirmation_ms" Milliseconds 1..=LONGEST_MS 5_000
        "within which a node has to confirm that it ended what a new access policy denies"
        "close code `stalled` (SM2-ACC-014)"
    QueueBytes "queue_bytes" Bytes SHORTEST_QUEUE_BYTES..=MOST 1_048_576
        "frames that wait for a node that does not read; each counts 32 bytes more than its length"
        "close code `stalled`"
    SchemaBytesPerSession "schema_bytes_per_session" Bytes 1..=MOST 262_144
        "schema texts of one session, with the names of their types"
        "the text is not kept"
    RefusalsPerSession "refusals_per_session" Count 1..=MOST 16
        "refused interfaces of one session that are remembered"
        "the oldest is forgotten"
    UnlinkedPerSession "unlinked_per_session" Count 1..=MOST 256
        "unlinked pairs that are remembered, per session of the publisher or server"
        "the pair is not remembered"
    ChangesRemembered "changes_remembered" Count 1..=MOST 4_096
        "changes of the domain that are remembered"
        "CHANGES without changes"
    LinksInFlight "links_in_flight" Count 1..=MOST 256
        "LINKs sent to one session before its socket has taken all of them"
        "they wait (SM2-LNK-006); a link of the session with itself may be one beyond"
    WorkPerTurn "work_per_turn" Count 1..=MOST 512
        "units of work for one input before other sessions are served: a link that is made costs 64, one that \
         ends 16, a comparison of two interfaces 1"
        "other sessions are served in between (SM2-SES-009); the first part of a DECLARE has four times as much"
}

impl Limit {
    /// The name, such as `sessions_per_user`. The unit is its end where it is not a count. With dashes, it is the name
    /// of the option of `sm2-manager`.
    #[must_use]
    pub const fn name(self) -> &'static str {
        self.row().name
    }

    /// The unit of the values.
    #[must_use]
    pub const fn unit(self) -> Unit {
        self.row().unit
    }

    /// The values that a Manager accepts.
    #[must_use]
    pub const fn range(self) -> RangeInclusive<u32> {
        self.row().range
    }

    /// The consequence of going beyond the limit, in the words of SPEC.
    #[must_use]
    pub const fn beyond(self) -> &'static str {
        self.row().beyond
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
    pub const fn show(self, value: u32) -> Shown {
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
    value: u32,
}

impl fmt::Display for Shown {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let value = self.value;
        match self.unit {
            Unit::Count => write!(f, "{value}"),
            Unit::Milliseconds if value.is_multiple_of(1_000) => write!(f, "{} s", value / 1_000),
            Unit::Milliseconds => write!(f, "{value} ms"),
            Unit::Bytes => Counted::new(value.into(), "byte").fmt(f),
        }
    }
}

/// The reason why a Manager does not accept its limits.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum LimitError {
    /// A value is outside of the range of its limit.
    #[error(
        "{} is {}: give {} to {}",
        .limit.name(),
        .limit.show(*.value),
        .limit.show(*.limit.range().start()),
        .limit.show(*.limit.range().end())
    )]
    OutOfRange {
        /// The limit.
        limit: Limit,
        /// Its value.
        value: u32,
    },
    /// A value exceeds that of the [`whole`](Limit::whole): the limit could never be reached.
    #[error(
        "{} is {}: give {} to {}, the value of {}, or raise that one",
        .limit.name(),
        .limit.show(*.value),
        .limit.show(*.limit.range().start()),
        .limit.show(*.most),
        .whole.name()
    )]
    AboveWhole {
        /// The limit.
        limit: Limit,
        /// Its value.
        value: u32,
        /// The limit that it exceeds.
        whole: Limit,
        /// The value of that one.
        most: u32,
    },
}

/// The limits of a Manager, and which links it seals.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct Limits {
    /// The value of each limit, in the order of [`Limit::ALL`] and in its [unit](Limit::unit).
    pub values: [u32; Limit::COUNT],
    /// Whether every link of the domain is sealed.
    pub seal_all: bool,
    /// Whether links between different users may be unsealed.
    pub waive_user_boundary: bool,
}

impl Default for Limits {
    fn default() -> Self {
        Self::DEFAULT
    }
}

impl Limits {
    /// The defaults.
    pub const DEFAULT: Self = {
        let mut limits = Self::all(0);
        let mut at = 0;
        while at < Limit::COUNT {
            limits.values[at] = Limit::ALL[at].row().default;
            at += 1;
        }
        limits
    };

    /// Each limit has this value.
    #[must_use]
    pub const fn all(value: u32) -> Self {
        Self {
            values: [value; Limit::COUNT],
            seal_all: false,
            waive_user_boundary: false,
        }
    }

    /// The value of a limit, in its [unit](Limit::unit).
    #[must_use]
    #[inline]
    pub const fn of(&self, limit: Limit) -> u32 {
        self.values[limit as usize]
    }

    /// The value of a limit that counts things or bytes.
    #[must_use]
    #[inline]
    pub const fn count(&self, limit: Limit) -> usize {
        self.of(limit) as usize
    }

    /// The ends of links that a session can have.
    pub(crate) fn links_per_session(&self) -> usize {
        self.count(Limit::LinksPerSession).min(LINKS_MAX)
    }

    /// The LINKs that a session is sent before its socket has taken all of them.
    //= SM2-LNK-006
    pub(crate) const fn links_in_flight(&self) -> usize {
        match self.count(Limit::LinksInFlight) {
            0 => 1,
            limit => limit,
        }
    }

    /// Whether a link is sealed even if neither side asks for it.
    //= SM2-MAT-003
    pub(crate) const fn seals(&self, same_user: bool) -> bool {
        self.seal_all || (!same_user && !self.waive_user_boundary)
    }

    /// The value of a limit in [milliseconds](Unit::Milliseconds).
    #[must_use]
    pub const fn time(&self, limit: Limit) -> Duration {
        Duration::from_millis(self.of(limit) as u64)
    }

    /// The same limits but for one.
    #[must_use]
    pub const fn with(mut self, limit: Limit, value: u32) -> Self {
        self.values[limit as usize] = value;
        self
    }

    /// Checks that every limit is within its range, and that no limit of a part exceeds that of the whole.
    /// A Manager works with any limits. A program that takes them from its user calls this function first.
    ///
    /// # Errors
    ///
    /// The [`LimitError`] of the first wrong limit.
    pub fn check(&self) -> Result<(), LimitError> {
        for limit in Limit::ALL {
            let value = self.of(limit);
            if !limit.range().contains(&value) {
                return Err(LimitError::OutOfRange { limit, value });
            }
        }
        for limit in Limit::ALL {
            let Some(whole) = limit.whole() else {
                continue;
            };
            let (value, most) = (self.of(limit), self.of(whole));
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
}

#[cfg(test)]
mod tests {
    use alloc::string::ToString as _;

    use super::*;

    #[test]
    fn names_differ_and_defaults_are_in_their_ranges() {
        for (at, one) in Limit::ALL.into_iter().enumerate() {
            for other in &Limit::ALL[..at] {
                assert_ne!(one.name(), other.name());
            }
        }
        assert_eq!(Limits::default().check(), Ok(()));
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
