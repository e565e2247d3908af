//! What a driver can ask a link at any moment.

use super::{Config, Counters, End, LaneKind, Link, Placement, lane::Lane, phase::Phase};

impl Link {
    /// Whether [`Link::poll`] may return an output; if `false`, it returns `None`. After a message
    /// on the ring lane there mostly is nothing to drain.
    #[must_use]
    #[inline]
    pub fn has_output(&self) -> bool {
        match &self.lane {
            Lane::Ring(ring) if self.greeted => {
                !self.events.is_empty() || ring.has_packets() || self.placed.has_cancels()
            }
            _ => true,
        }
    }

    /// Whether both OPEN were exchanged, and RING where the link has one, and the link is not over.
    #[must_use]
    #[inline]
    pub fn is_open(&self) -> bool {
        self.state == Ok(Phase::Open) && !self.lane.awaits_ring()
    }

    /// Why the link is over, if it is.
    #[must_use]
    #[inline]
    pub fn end(&self) -> Option<End> {
        self.state.err()
    }

    /// The configuration of this end.
    #[must_use]
    #[inline]
    pub const fn config(&self) -> &Config {
        &self.config
    }

    /// The lane of this link, for reports: every method works on both lanes.
    #[must_use]
    #[inline]
    pub const fn lane(&self) -> LaneKind {
        self.lane.kind()
    }

    /// Where the payload of a message has to be, so that [`Link::send`] takes it.
    #[must_use]
    #[inline]
    pub const fn placement(&self) -> Placement {
        match &self.lane {
            // A slot is legal on either lane.
            Lane::Undecided | Lane::Ring(_) => Placement::Slot,
            Lane::Socket(_) if self.config.sealed => Placement::InlineOrSealed,
            Lane::Socket(_) => Placement::InlineOrSlot,
        }
    }

    /// Whether the socket becomes readable with each message of the other end. If not, it does so
    /// only after [`Link::park`], and messages are found by [`Link::is_ready`].
    #[must_use]
    #[inline]
    pub const fn is_woken_by_socket(&self) -> bool {
        !matches!(self.lane, Lane::Ring(_))
    }

    /// What became of the messages that this end was given to send.
    #[must_use]
    #[inline]
    pub fn counters(&self) -> Counters {
        self.lane.counters()
    }

    /// Whether a deadline passed ([`Input::Skip`](super::Input::Skip)) and the other end has
    /// released nothing since: such a link is not waited for (SM2-QOS-002).
    #[must_use]
    #[inline]
    pub fn is_stalled(&self) -> bool {
        self.lane.is_stalled()
    }

    /// How many messages of this end are not settled.
    #[must_use]
    pub fn in_flight(&self) -> usize {
        self.lane.in_flight()
    }

    /// How many calls have no reply. A caller counts the calls that it made, also after the end as
    /// long as [`Link::take`] may bring their replies; a server counts the calls that it took and
    /// whose reply has not left.
    #[must_use]
    pub fn calls(&self) -> usize {
        self.placed.len() + self.served.len()
    }

    /// Whether messages of a caller or server wait and nothing is known to hold them up:
    /// [`Link::harvest`] sends them, or finds out what holds them up.
    #[must_use]
    pub fn is_due(&self) -> bool {
        matches!(&self.lane, Lane::Ring(ring) if !self.blocked && ring.is_due())
    }

    /// Whether messages of a caller or server wait for room, or for a segment.
    #[must_use]
    pub fn is_waiting(&self) -> bool {
        matches!(&self.lane, Lane::Ring(ring) if ring.is_waiting())
    }
}
