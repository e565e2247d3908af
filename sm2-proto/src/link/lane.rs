//! The two lanes of a link, and the state before the lane is known.
//!
//! A link that is not sealed uses the ring lane if both ends offer it. The ring then carries every message, short ones
//! included, so no rule for the order between lanes is needed. The socket carries the rare events: segments, the
//! DOORBELL that wakes a sleeping side, and the end. The receiver creates the file of a ring, because it knows how many
//! messages it accepts. It does so before OPEN, so that a process without a free descriptor can fall back to the
//! socket.

use super::{Config, Counters, LinkMemory, ring::RingLane, socket_lane::SocketLane};
use crate::{Instant, Newest};

/// The lane of a link's messages, with the state that only this lane has.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub(super) enum Lane {
    /// This end offers both lanes, and the other end's OPEN has not come. Until then no message is
    /// accepted, because a message that was placed for one lane could not be sent on the other.
    //= SM2-RNG-001
    Undecided,
    /// Messages are sent over the socket (SPEC sections 8.1 to 8.4).
    Socket(SocketLane),
    /// Messages are sent through rings in shared memory (SPEC section 8.5).
    Ring(RingLane),
}

/// The lane of a link, for reports.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum LaneKind {
    /// The other end's OPEN has not come yet.
    Undecided,
    /// Messages are sent over the socket.
    Socket,
    /// Messages are sent through rings in shared memory.
    Ring,
}

impl Lane {
    /// The lane before the other end's OPEN.
    pub(super) fn new(config: &Config) -> Self {
        match config.ring {
            true => Self::Undecided,
            false => Self::Socket(SocketLane::new(config)),
        }
    }

    pub(super) const fn kind(&self) -> LaneKind {
        match self {
            Self::Undecided => LaneKind::Undecided,
            Self::Socket(_) => LaneKind::Socket,
            Self::Ring(_) => LaneKind::Ring,
        }
    }

    /// The id of the last message that the application passed to this end.
    pub(super) const fn last_id(&self) -> Option<u64> {
        match self {
            Self::Undecided => None,
            Self::Socket(socket) => socket.outbound.last_id(),
            Self::Ring(ring) => ring.last_id(),
        }
    }

    /// Whether the other end's RING has not come yet.
    #[inline]
    pub(super) const fn awaits_ring(&self) -> bool {
        matches!(self, Self::Ring(ring) if ring.is_awaited())
    }

    #[inline]
    pub(super) fn counters(&self) -> Counters {
        match self {
            Self::Undecided => Counters::default(),
            Self::Socket(socket) => socket.outbound.counters(),
            Self::Ring(ring) => ring.counters(),
        }
    }

    pub(super) fn in_flight(&self) -> usize {
        match self {
            Self::Undecided => 0,
            Self::Socket(socket) => socket.outbound.in_flight(),
            Self::Ring(ring) => ring.in_flight(),
        }
    }

    #[inline]
    pub(super) fn owes(&self) -> bool {
        match self {
            Self::Undecided => false,
            Self::Socket(socket) => socket.outbound.owes(),
            Self::Ring(ring) => ring.owes(),
        }
    }

    /// The newest message that has come, whether it was taken or not.
    pub(super) fn newest(&self, memory: &impl LinkMemory) -> Newest {
        match self {
            Self::Undecided => Newest::NONE,
            Self::Socket(socket) => socket.inbound.newest(),
            Self::Ring(ring) => match (&ring.incoming, memory.incoming()) {
                (Some(receiver), Some(words)) => receiver.newest(words),
                _ => Newest::NONE,
            },
        }
    }

    /// Drops the messages that wait and have expired. Passes their keys to `each`.
    //= SM2-QOS-010
    pub(super) fn expire_unsent(&mut self, now: Instant, each: impl FnMut(u64)) {
        if let Self::Socket(socket) = self {
            socket.outbound.expire(now, each);
        }
    }

    /// Ends the lane with its link. Passes the keys of all messages that were not settled to
    /// `each`.
    //= SM2-OPN-009
    pub(super) fn end(&mut self, by_violation: bool, each: impl FnMut(u64)) {
        match self {
            Self::Undecided => {}
            Self::Socket(socket) => socket.end(each),
            Self::Ring(ring) => ring.end(by_violation, each),
        }
    }

    /// Checks the invariants, which hold after each call.
    #[inline]
    pub(super) fn invariants(&self) {
        match self {
            Self::Undecided => {}
            Self::Socket(socket) => socket.invariants(),
            Self::Ring(ring) => ring.invariants(),
        }
    }
}
