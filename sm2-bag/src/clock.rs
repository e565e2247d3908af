//! The relation of the wall clock to the monotonic clock.

use std::collections::BTreeMap;
use std::time::Duration;

use sm2_node::clock::DomainTime;
use sm2_proto::Instant;

/// Reads a wall clock. A recorder reads [that of the machine](sm2_node::clock::wall_time), and tests give it one that
/// steps.
pub type WallClock = fn() -> DomainTime;

/// Reads a monotonic clock. A recorder reads [that of the machine](sm2_io::clock::now), and tests give it one that they
/// move on.
pub type MonotonicClock = fn() -> Instant;

/// A moment, read from both clocks.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ClockRelation {
    /// The monotonic clock.
    pub monotonic: Instant,
    /// The wall clock, in nanoseconds since 1970 (UTC).
    pub wall_ns: u64,
}

impl ClockRelation {
    /// The name of its metadata record.
    pub(crate) const RECORD: &str = "sm2.clock";

    /// Reads both clocks.
    pub(crate) fn read(wall_clock: WallClock, monotonic_clock: MonotonicClock) -> Self {
        let DomainTime(wall_ns) = wall_clock();
        Self {
            monotonic: monotonic_clock(),
            wall_ns,
        }
    }

    /// The time of the wall clock at a time of the monotonic clock.
    #[must_use]
    pub const fn wall_at(&self, monotonic: Instant) -> u64 {
        match monotonic.0.checked_sub(self.monotonic.0) {
            Some(later) => self.wall_ns.saturating_add(later),
            None => self.wall_ns.saturating_sub(self.monotonic.0 - monotonic.0),
        }
    }

    /// How far the wall clock has stepped between this moment and a later one, forwards or backwards.
    pub(crate) fn step_to(&self, later: &Self) -> Duration {
        Duration::from_nanos(later.wall_ns.abs_diff(self.wall_at(later.monotonic)))
    }

    pub(crate) fn metadata(&self) -> BTreeMap<String, String> {
        BTreeMap::from([
            ("monotonic_ns".to_owned(), self.monotonic.0.to_string()),
            ("wall_ns".to_owned(), self.wall_ns.to_string()),
        ])
    }

    pub(crate) fn from_metadata(metadata: &BTreeMap<String, String>) -> Option<Self> {
        Some(Self {
            monotonic: Instant(metadata.get("monotonic_ns")?.parse().ok()?),
            wall_ns: metadata.get("wall_ns")?.parse().ok()?,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const START: ClockRelation = ClockRelation {
        monotonic: Instant(1_000),
        wall_ns: 5_000,
    };

    #[test]
    fn the_wall_clock_follows_the_monotonic_clock() {
        assert_eq!(START.wall_at(Instant(1_500)), 5_500);
        assert_eq!(START.wall_at(Instant(400)), 4_400);
        assert_eq!(START.wall_at(Instant(u64::MAX)), u64::MAX);
        let early = ClockRelation {
            wall_ns: 10,
            ..START
        };
        assert_eq!(early.wall_at(Instant(0)), 0);
    }

    #[test]
    fn a_step_is_seen_in_both_directions() {
        for (wall_ns, step) in [(5_500, 0), (9_500, 4_000), (1_500, 4_000)] {
            let later = ClockRelation {
                monotonic: Instant(1_500),
                wall_ns,
            };
            assert_eq!(START.step_to(&later), Duration::from_nanos(step));
        }
    }

    #[test]
    fn a_record_has_both_clocks() {
        assert_eq!(ClockRelation::from_metadata(&START.metadata()), Some(START));
        let broken = BTreeMap::from([("wall_ns".to_owned(), "1".to_owned())]);
        assert_eq!(ClockRelation::from_metadata(&broken), None);
    }
}
