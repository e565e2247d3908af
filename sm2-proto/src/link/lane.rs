//! The two lanes of a link, and the state before the lane is known.

use super::{Config, Counters, ring::RingLane, socket_lane::SocketLane};

/// How the messages of a link go, with the state that only this lane has.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub(super) enum Lane {
    /// This end offers both lanes, and the other end's OPEN has not come. No message is taken
    /// until then, since a message for one lane could not leave by the other.
    //= SM2-RNG-001
    Undecided,
    /// Messages go by the socket (SPEC sections 8.1 to 8.4).
    Socket(SocketLane),
    /// Messages go by rings in shared memory (SPEC section 8.5).
    Ring(RingLane),
}

/// The lane of a link, for reports.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum LaneKind {
    /// The other end's OPEN has not come yet.
    Undecided,
    /// Messages go by the socket.
    Socket,
    /// Messages go by rings in shared memory.
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

    /// The id of the last message that this end was given to send.
    pub(super) const fn last_id(&self) -> Option<u64> {
        match self {
            Self::Undecided => None,
            Self::Socket(socket) => socket.outbound.last_id(),
            Self::Ring(ring) => ring.last_id(),
        }
    }

    /// Whether the other end's RING is still to come.
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
    pub(super) fn is_stalled(&self) -> bool {
        match self {
            Self::Undecided => false,
            Self::Socket(socket) => socket.outbound.is_stalled(),
            Self::Ring(ring) => ring.is_stalled(),
        }
    }

    /// The link is over. Passes the keys of all messages that were not settled to `each`.
    //= SM2-OPN-007
    pub(super) fn end(&mut self, by_violation: bool, each: impl FnMut(u64)) {
        match self {
            Self::Undecided => {}
            Self::Socket(socket) => socket.end(each),
            Self::Ring(ring) => ring.end(by_violation, each),
        }
    }

    /// Checks what must hold between any two calls.
    #[inline]
    pub(super) fn invariants(&self) {
        match self {
            Self::Undecided => {}
            Self::Socket(socket) => socket.invariants(),
            Self::Ring(ring) => ring.invariants(),
        }
    }
}
