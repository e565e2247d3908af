//! Messages on either lane: one send, one take, one release, whatever the ends agreed on.
//!
//! The ring lane needs memory that both ends map. A driver lends it for one call as a
//! [`LinkMemory`]; a link of the socket lane does not touch it, and [`NoMemory`] stands for none.
//!
//! | a sender's driver | calls |
//! | --- | --- |
//! | before it writes a message | [`Link::needs_slot`]: whether the payload has to be in a slot |
//! | before it waits, or may choose | [`Link::has_room`] |
//! | for each message | [`Link::send`]; if that says [`Misuse::NotAttached`], [`Attach`], and once more |
//! | to learn what came back | [`Link::harvest`] |
//! | before it sleeps until there is room | [`Link::park`], and looks again |
//!
//! | a receiver's driver | calls |
//! | --- | --- |
//! | for the next message | [`Link::take`], then [`Link::made_room`]; [`Link::peek`] says what to prefetch |
//! | when the application gives one back | [`Link::release`] |
//! | before it sleeps | [`Link::park`], and looks again |
//!
//! A caller's or server's driver does both, but for this: [`Link::send`] takes every message and
//! attaches segments as need be. After it and after each other change the driver drains, and as
//! long as [`Link::is_due`] says so it harvests, which sends what waits, and drains.
//!
//! Where a call returns that the other end wants the bell, the driver sends [`doorbell`] and does
//! not care whether the socket takes it.
//!
//! [`Attach`]: super::Input::Attach
//! [`doorbell`]: super::doorbell

use core::convert::Infallible;

use super::{
    At, Delivery, End, Error, Fate, Link, Misuse, OutboundMessage, RingMemory, TooManyBorrowed,
    ring::{Ring, RingMessage},
};
use crate::limits::SLOT_HEAD;

/// What a driver lends to a link for the time of one call.
pub trait LinkMemory {
    /// A ring that is mapped.
    type Ring: RingMemory;

    /// The ring that this end sends by, if it is mapped.
    fn outgoing(&self) -> Option<&Self::Ring>;

    /// The ring that this end takes messages from, if it is mapped.
    fn incoming(&self) -> Option<&Self::Ring>;

    /// A copy of the last 64 bytes of a slot: by the segment's number, the slot's offset and its
    /// length in bytes. None if this segment is not mapped.
    fn slot_head(&self, segment: u32, offset: u64, stride: u64) -> Option<[u8; SLOT_HEAD]>;
}

/// One ring alone, which can be sent by and given back to, but not taken from.
impl<R: RingMemory> LinkMemory for R {
    type Ring = R;

    #[inline]
    fn outgoing(&self) -> Option<&R> {
        Some(self)
    }

    #[inline]
    fn incoming(&self) -> Option<&R> {
        Some(self)
    }

    fn slot_head(&self, _: u32, _: u64, _: u64) -> Option<[u8; SLOT_HEAD]> {
        None
    }
}

/// One ring, and how to copy the heads of slots.
#[derive(Clone, Copy, Debug)]
pub struct Lent<'a, R, F> {
    ring: &'a R,
    head: F,
}

impl<'a, R, F> Lent<'a, R, F> {
    /// `head` is [`LinkMemory::slot_head`].
    #[inline]
    pub const fn new(ring: &'a R, head: F) -> Self {
        Self { ring, head }
    }
}

impl<R, F> LinkMemory for Lent<'_, R, F>
where
    R: RingMemory,
    F: Fn(u32, u64, u64) -> Option<[u8; SLOT_HEAD]>,
{
    type Ring = R;

    #[inline]
    fn outgoing(&self) -> Option<&R> {
        Some(self.ring)
    }

    #[inline]
    fn incoming(&self) -> Option<&R> {
        Some(self.ring)
    }

    #[inline]
    fn slot_head(&self, segment: u32, offset: u64, stride: u64) -> Option<[u8; SLOT_HEAD]> {
        (self.head)(segment, offset, stride)
    }
}

/// Nothing is lent: enough for every link that is not of the ring lane.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct NoMemory;

/// A ring that does not exist.
#[derive(Debug)]
pub struct NoRing(Infallible);

impl LinkMemory for NoMemory {
    type Ring = NoRing;

    fn outgoing(&self) -> Option<&NoRing> {
        None
    }

    fn incoming(&self) -> Option<&NoRing> {
        None
    }

    fn slot_head(&self, _: u32, _: u64, _: u64) -> Option<[u8; SLOT_HEAD]> {
        None
    }
}

impl RingMemory for NoRing {
    fn load(&self, _: At) -> u64 {
        match self.0 {}
    }

    fn swap(&self, _: At, _: u64) -> u64 {
        match self.0 {}
    }

    fn take(&self, _: At, _: u64) -> bool {
        match self.0 {}
    }

    fn fence(&self) {
        match self.0 {}
    }
}

/// Why [`Link::take`] gives no message, although there may be one.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum NoDelivery {
    /// The application holds all that it may.
    #[error(transparent)]
    TooManyBorrowed(TooManyBorrowed),
    /// Ring lane: the message is in a segment that is not attached. Feed all datagrams that are
    /// there, and try again. If none is there, feed
    /// [`Input::SegmentMissing`](super::Input::SegmentMissing).
    #[error("the message is in a segment that is not attached yet")]
    UnknownSegment,
    /// Ring lane: the link is over, perhaps by a violation that was just found.
    #[error(transparent)]
    Ended(End),
    /// Ring lane: this end has no ring to take from, or it was not lent.
    #[error(transparent)]
    Misuse(Misuse),
}

impl Link {
    /// Sends a message: DATA, REQUEST or REPLY by the role. Returns whether the other end wants
    /// the bell. `settled` hears of messages that the ring lane settles by this; the socket lane
    /// says it by [`Output::Settled`](super::Output::Settled).
    ///
    /// # Errors
    /// [`Error::Misuse`]: nothing was sent. [`Misuse::NoRoom`]: only reliable links, and on the
    /// ring lane all while a packet is blocked. [`Error::Ended`]: if the link was over before,
    /// nothing was sent; else it is over by this, since the receiver broke SPEC or does not run
    /// (SM2-RNG-011), and the outputs settle also this message.
    pub fn send(
        &mut self,
        memory: &impl LinkMemory,
        message: OutboundMessage,
        mut settled: impl FnMut(u64, Fate),
    ) -> Result<bool, Error> {
        let result = match (self.state, &self.ring) {
            (Err(end), _) => Err(Error::Ended(end)),
            (Ok(_), None) => match self.send_by_socket(message) {
                Ok(()) => Ok(false),
                Err(misuse) => Err(misuse.into()),
            },
            (Ok(_), Some(_)) => {
                let ring = memory.outgoing().ok_or(Misuse::WrongLane)?;
                let message = RingMessage::of(&message).ok_or(Misuse::NotPooled)?;
                self.send_by_ring(ring, &message, &mut settled)
            }
        };
        self.invariants();
        result
    }

    /// Whether the payload of a message has to be in a slot, with its [head](super::SlotHead), for
    /// this link to send it.
    #[must_use]
    #[inline]
    pub const fn needs_slot(&self) -> bool {
        self.has_ring()
    }

    /// Takes back what the receiver gave back, as far as it is there, and sends what waits, as far
    /// as there is room. Returns whether the receiver wants the bell. The socket lane does both by
    /// itself.
    ///
    /// # Errors
    /// As [`send`](Self::send).
    #[inline]
    pub fn harvest(
        &mut self,
        memory: &impl LinkMemory,
        mut settled: impl FnMut(u64, Fate),
    ) -> Result<bool, Error> {
        if let Err(end) = self.state {
            return Err(Error::Ended(end));
        }
        match (&self.ring, memory.outgoing()) {
            (None, _) => Ok(false),
            (Some(_), None) => Err(Misuse::WrongLane.into()),
            (Some(_), Some(ring)) => self.harvest_ring(ring, &mut settled),
        }
    }

    /// Whether one more message would neither displace another nor be refused for want of room or
    /// for too many calls.
    #[inline]
    pub fn has_room(&self, memory: &impl LinkMemory) -> bool {
        match &self.ring {
            None => self.has_room_by_socket(),
            Some(_) => memory
                .outgoing()
                .is_some_and(|ring| self.has_room_in_ring(ring)),
        }
    }

    /// The next message for the application, the oldest first; none if none is ready. It is the
    /// application's until [`release`](Self::release).
    ///
    /// # Errors
    /// See [`NoDelivery`].
    #[inline]
    pub fn take(&mut self, memory: &impl LinkMemory) -> Result<Option<Delivery>, NoDelivery> {
        if self.ring.is_some() {
            return self.take_from_ring(memory);
        }
        let taken = self.inbound.take().map_err(NoDelivery::TooManyBorrowed);
        self.invariants();
        taken
    }

    /// Where the next message seems to be, on the ring lane: its segment, the offset of its slot and
    /// that one's length in bytes. Only that there is such a slot was checked: it is for a driver
    /// that tells the processor what is read next.
    #[inline]
    pub fn peek(&self, memory: &impl LinkMemory) -> Option<(u32, u64, u64)> {
        self.peek_into_ring(memory.incoming()?)
    }

    /// Whether [`take`](Self::take) may give a message.
    #[inline]
    pub fn is_ready(&self, memory: &impl LinkMemory) -> bool {
        match &self.ring {
            None => self.inbound.ready() > 0,
            Some(_) => memory
                .incoming()
                .is_some_and(|ring| self.is_ring_ready(ring)),
        }
    }

    /// How many messages the application has not taken, at most.
    #[inline]
    pub fn ready(&self, memory: &impl LinkMemory) -> usize {
        match &self.ring {
            None => self.inbound.ready(),
            Some(_) => memory.incoming().map_or(0, |ring| self.ready_in_ring(ring)),
        }
    }

    /// The application gives back a message that it took. Returns whether the sender wants the bell.
    ///
    /// # Errors
    /// As [`handle`](Self::handle) of [`Input::Release`](super::Input::Release).
    #[inline]
    pub fn release(&mut self, memory: &impl LinkMemory, sequence: u64) -> Result<bool, Error> {
        if self.ring.is_none() {
            return self.release_by_socket(sequence).map(|()| false);
        }
        let ring = memory.incoming().ok_or(Misuse::WrongLane)?;
        self.release_to_ring(ring, sequence)
    }

    /// After a message was taken: whether the sender wants the bell, since there is room now. Only
    /// a reliable link's sender waits for that.
    #[inline]
    pub fn made_room(&self, memory: &impl LinkMemory) -> bool {
        self.config.reliable
            && memory
                .incoming()
                .is_some_and(|ring| self.made_room_in_ring(ring))
    }

    /// This end is about to sleep until its socket is readable. The driver looks for messages or
    /// room once more before it does.
    //= SM2-RNG-009
    #[inline]
    pub fn park(&self, memory: &impl LinkMemory) {
        self.set_parked(memory, true);
    }

    /// This end does not sleep any more, with none of its threads.
    #[inline]
    pub fn unpark(&self, memory: &impl LinkMemory) {
        self.set_parked(memory, false);
    }

    fn set_parked(&self, memory: &impl LinkMemory, parked: bool) {
        let Some(at) = self.ring.as_ref().and_then(Ring::parked_word) else {
            return;
        };
        let ring = match at {
            At::SenderParked => memory.outgoing(),
            At::ReceiverParked | At::Forward(_) | At::Back(_) => memory.incoming(),
        };
        let Some(ring) = ring else { return };
        ring.swap(at, u64::from(parked));
        if parked {
            // Pairs with the fence in `wants_bell`: the other end's re-check of our parked word
            // sees that we parked, or we see its word when we look again.
            ring.fence();
        }
    }
}
