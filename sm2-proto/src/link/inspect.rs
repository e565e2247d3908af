//! Methods that let a driver inspect a link at any time.

use super::{
    Config, Counters, End, LaneKind, Link, LinkMemory, Placement, Publications, Role, lane::Lane,
    phase::Phase,
};
use crate::{Instant, Newest, Period, QosWatch};

impl Link {
    /// Whether [`poll`](crate::Machine::poll) may return an output. If this is `false`, `poll` returns
    /// `None`. On the ring lane there is usually nothing to drain after a message.
    #[must_use]
    #[inline]
    pub fn has_output(&self) -> bool {
        match &self.lane {
            Lane::Ring(ring) if self.open_sent => {
                !self.events.is_empty()
                    || self.ring_due
                    || ring.has_packets()
                    || self.placed.has_cancels()
            }
            _ => true,
        }
    }

    /// Whether the link is ready for messages: both ends sent OPEN, an expected RING has come, and
    /// the link is not over.
    #[must_use]
    #[inline]
    pub fn is_open(&self) -> bool {
        matches!(self.state, Ok(Phase::Open)) && !self.lane.awaits_ring()
    }

    /// Whether short messages can be sent in cells now: see [`send_in_cell`](Self::send_in_cell). On a reliable link of
    /// a topic, there must also be [room](Self::has_room).
    //= SM2-RNG-013
    #[must_use]
    #[inline]
    pub fn takes_cells(&self, memory: &impl LinkMemory) -> bool {
        let (Lane::Ring(ring), Some(words)) = (&self.lane, memory.outgoing()) else {
            return false;
        };
        let Some(sender) = ring.sender() else {
            return false;
        };
        let has_room = || match self.config.role {
            Role::Sender => true,
            _ => !ring.has_queued() && sender.has_room(words),
        };
        self.state.is_ok() && !self.blocked && self.config.lifespan == Period::NONE && has_room()
    }

    /// The reason why the link is over, if it is.
    #[must_use]
    #[inline]
    pub fn end(&self) -> Option<End> {
        self.state.err().map(|it| it.end)
    }

    /// The configuration of this end.
    #[must_use]
    #[inline]
    pub const fn config(&self) -> &Config {
        &self.config
    }

    /// The length of the longest message that the other end accepts, in bytes. The limit of the
    /// protocol until its OPEN has come.
    #[must_use]
    #[inline]
    pub const fn peer_max_len(&self) -> u64 {
        self.peer_max_len
    }

    /// The publications that the OPEN of the publisher at the other end stated. [`Publications::UNKNOWN`] until that
    /// has come.
    #[must_use]
    #[inline]
    pub const fn peer_publications(&self) -> Publications {
        self.peer_publications
    }

    /// The lane of this link, for reports. Every method works on both lanes.
    #[must_use]
    #[inline]
    pub const fn lane(&self) -> LaneKind {
        self.lane.kind()
    }

    /// Where the payload of a message has to be so that [`Link::send`] accepts the message.
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

    /// Whether each message of the other end makes the socket readable. If not, the socket becomes
    /// readable only after [`Link::park`], and the driver finds messages by [`Link::may_take`].
    #[must_use]
    #[inline]
    pub const fn is_woken_by_socket(&self) -> bool {
        !matches!(self.lane, Lane::Ring(_))
    }

    /// The newest message that has come, whether it was taken or not, for [`Input::Tick`](super::Input::Tick).
    #[must_use]
    pub fn newest(&self, memory: &impl LinkMemory) -> Newest {
        self.lane.newest(memory)
    }

    /// How the publisher at the other end keeps its deadline and its lease, as far as the last
    /// [tick](super::Input::Tick) and the last ALIVE tell. Watches nothing for all roles but a receiver.
    #[must_use]
    #[inline]
    pub const fn watch(&self) -> &QosWatch {
        &self.qos_timers.watch
    }

    /// As [`watch`](Self::watch), to take the changes since the last call.
    #[inline]
    pub const fn watch_mut(&mut self) -> &mut QosWatch {
        &mut self.qos_timers.watch
    }

    /// Whether a message with this time of publication is older than its lifespan now.
    //= SM2-QOS-010
    #[must_use]
    #[inline]
    pub fn is_expired(&self, time: Instant, now: impl FnOnce() -> Instant) -> bool {
        self.config.lifespan.has_passed_by(time, now)
    }

    /// Counts of the messages that the application passed to this end, by outcome.
    #[must_use]
    #[inline]
    pub fn counters(&self) -> Counters {
        self.lane.counters()
    }

    /// Whether the link owes: a publication was dropped ([`Fate::NoRoom`](super::Fate::NoRoom) or
    /// [`Fate::PoolLimit`](super::Fate::PoolLimit)), and the other end has not released all
    /// messages that were in flight then. A publisher does not wait for such a link (SM2-QOS-003).
    #[must_use]
    #[inline]
    pub fn owes(&self) -> bool {
        self.lane.owes()
    }

    /// How many messages of this end are not settled.
    #[must_use]
    pub fn in_flight(&self) -> usize {
        self.lane.in_flight()
    }

    /// Passes the key of each message of this end that is not settled to `each`, in no particular
    /// order.
    pub fn in_flight_keys(&self, each: impl FnMut(u64)) {
        match &self.lane {
            Lane::Undecided => {}
            Lane::Socket(socket) => socket.outbound.keys().for_each(each),
            Lane::Ring(ring) => {
                if let Some(sender) = ring.sender() {
                    sender.keys().for_each(each);
                }
            }
        }
    }

    /// How many calls have no reply. A caller counts the calls that it made. It still counts them
    /// after the end while [`Link::take`] may return their replies. A server counts the calls that
    /// it took and whose reply has not been sent.
    #[must_use]
    pub fn calls(&self) -> usize {
        self.placed.len() + self.served.len()
    }

    /// Whether [`Link::harvest`] should be called to send the queued messages of a caller or
    /// server. True if messages are queued and no obstacle is known; `harvest` sends them, or finds
    /// the obstacle.
    #[must_use]
    pub fn is_due(&self) -> bool {
        matches!(&self.lane, Lane::Ring(ring) if !self.blocked && ring.is_due())
    }

    /// Whether accepted messages are queued on this side until the other side makes room. On the ring lane, only
    /// callers and servers queue messages, and also until a segment is attached.
    #[must_use]
    pub fn has_queued(&self) -> bool {
        match &self.lane {
            Lane::Undecided => false,
            Lane::Socket(socket) => socket.outbound.has_queued(),
            Lane::Ring(ring) => ring.has_queued(),
        }
    }
}
