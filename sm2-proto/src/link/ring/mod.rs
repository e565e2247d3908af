//! The ring lane of a link: SPEC section 8.5.
//!
//! A ring is a file of words that both ends map for writing. This module decides what is
//! written where and judges all that is read; it reaches the words through [`RingMemory`], three
//! atomic operations and a fence, which the driver lends for the time of a call. Whatever the
//! other end writes there leads to a message, to nothing, or to a violation.
//!
//! A link of a topic has one ring. One of a service has two: *outgoing* carries what this end
//! sends, *incoming* what it receives. What a driver calls is in [`lane`](super::lane).

#[cfg(any(kani, test))]
mod proofs;
mod receiver;
mod rings;
mod sender;
mod service;
mod word;

use self::rings::Outgoing;
pub(super) use self::sender::RingMessage;
pub use self::word::{At, EMPTY, NotAWord, RingLayout, SlotHead, Word};
pub(super) use self::{
    receiver::{NotTaken, RingReceiver},
    rings::{Ring, receiver_of, sender_of},
    sender::{RingSender, Step, Unsent},
};
use super::{
    Attachment, Delivery, End, Error, Fate, Frame, Head, Link, LinkMemory, Misuse, NoDelivery,
    Output, Packet, Role, segments::Verified, wire::Carrier,
};
use crate::{Farewell, FdFacts, Violation};

/// How many messages may be displaced in a row before the receiver counts as stopped. Then the
/// low halves of sequence numbers still tell how often the sender went round.
//= SM2-RNG-011
const DISPLACED_MAX: u32 = 1 << 31;

/// The words of one ring, in memory that the other end writes too.
///
/// All of it is atomic. [`load`](Self::load) acquires; [`swap`](Self::swap) and
/// [`take`](Self::take) acquire and release. What is not a word of the ring's
/// [layout](RingLayout) is never asked for.
pub trait RingMemory {
    /// Reads a word.
    fn load(&self, at: At) -> u64;
    /// Writes a word, and gives the one that was there.
    fn swap(&self, at: At, bits: u64) -> u64;
    /// Writes [`EMPTY`] if `bits` are still there; whether they were.
    fn take(&self, at: At, bits: u64) -> bool;
    /// A sequentially consistent fence.
    fn fence(&self);
}

/// The datagram that wakes the other end.
//= SM2-RNG-009
#[must_use]
pub fn doorbell() -> Head {
    Frame::Doorbell.head()
}

/// Whether the other end, which has this parked word, has to be woken after a word that was put.
//= SM2-RNG-009
#[inline]
fn wants_bell(words: &impl RingMemory, parked: At) -> bool {
    // Pairs with the fence in `Link::park`: the other end sees our word when it looks again, or we
    // see that it parked.
    words.fence();
    words.load(parked) != EMPTY && words.swap(parked, EMPTY) == 1
}

impl Link {
    /// [`Link::send`] on the ring lane.
    pub(super) fn send_by_ring(
        &mut self,
        words: &impl RingMemory,
        message: &RingMessage,
        settled: &mut impl FnMut(u64, Fate),
    ) -> Result<bool, Error> {
        if self.has_calls() {
            return self.queue_for_ring(words, message, settled);
        }
        let Some(sender) = sender_of(&mut self.ring) else {
            return Err(Misuse::WrongLane.into());
        };
        if self.blocked {
            return Err(Misuse::NoRoom.into());
        }
        match sender.send(words, message, settled) {
            Ok(bell) => Ok(bell),
            Err(Unsent::Misuse(misuse)) => Err(misuse.into()),
            Err(Unsent::Violation(violation)) => Err(self.violated(violation)),
            Err(Unsent::Stopped) => {
                let end = End::Local(Farewell::Stalled.code());
                self.finish(end);
                Err(Error::Ended(end))
            }
        }
    }

    /// [`Link::harvest`] on the ring lane.
    pub(super) fn harvest_ring(
        &mut self,
        words: &impl RingMemory,
        settled: &mut impl FnMut(u64, Fate),
    ) -> Result<bool, Error> {
        let Some(sender) = sender_of(&mut self.ring) else {
            return Err(Misuse::WrongLane.into());
        };
        let harvested = sender.harvest(words, settled);
        let result = harvested
            .and_then(|()| self.send_waiting(words, settled))
            .map_err(|violation| self.violated(violation));
        self.invariants();
        result
    }

    /// [`Link::has_room`] on the ring lane.
    pub(super) fn has_room_in_ring(&self, words: &impl RingMemory) -> bool {
        let room = |sender: &RingSender| match self.has_calls() {
            true => self.placed.check().is_ok(),
            false => !self.blocked && sender.has_room(words),
        };
        self.state.is_ok() && self.ring.as_ref().and_then(Ring::sender).is_some_and(room)
    }

    /// [`Input::PassOver`](super::Input::PassOver) on the ring lane.
    pub(super) fn pass_over_ring(&mut self) -> Result<(), Misuse> {
        match sender_of(&mut self.ring) {
            Some(sender) if self.config.role == Role::Sender => {
                sender.skip(Fate::Overwritten);
                Ok(())
            }
            _ => Err(Misuse::WrongLane),
        }
    }

    /// [`Link::take`] on the ring lane.
    #[inline]
    pub(super) fn take_from_ring(
        &mut self,
        memory: &impl LinkMemory,
    ) -> Result<Option<Delivery>, NoDelivery> {
        let is_awaited = self.is_ring_awaited();
        let (Some(receiver), Some(words)) = (receiver_of(&mut self.ring), memory.incoming()) else {
            return Err(NoDelivery::Misuse(Misuse::WrongLane));
        };
        //= SM2-RNG-002
        if is_awaited {
            return Ok(None);
        }
        let inbound = &self.inbound;
        let taken = receiver.take(
            words,
            |segment| inbound.geometry(segment),
            |segment, offset, stride| memory.slot_head(segment, offset, stride),
        );
        let judged = taken.and_then(|taken| {
            self.note_call(taken.as_ref())?;
            Ok(taken)
        });
        let result = judged.map_err(|why| match why {
            NotTaken::TooManyBorrowed(error) => NoDelivery::TooManyBorrowed(error),
            NotTaken::UnknownSegment => NoDelivery::UnknownSegment,
            NotTaken::Violation(violation) => self.ring_violated(violation),
        });
        self.invariants();
        result
    }

    /// [`Link::peek`].
    #[inline]
    pub(super) fn peek_into_ring(&self, words: &impl RingMemory) -> Option<(u32, u64, u64)> {
        let word = self.ring_receiver()?.peek(words)?;
        let geometry = self.inbound.geometry(word.segment.into())?;
        let offset = geometry.offset(word.slot.into())?;
        Some((word.segment.into(), offset, geometry.stride()))
    }

    /// [`Input::SegmentMissing`](super::Input::SegmentMissing), on a link that is over or not.
    //= SM2-RNG-007
    pub(super) fn on_segment_missing(&mut self) {
        if receiver_of(&mut self.ring).is_some() {
            let _ = self.ring_violated(violation!(UnknownSegment, "SM2-RNG-007"));
        }
    }

    /// What is left in the ring of a link that is over can be wrong as well: then nothing is left.
    fn ring_violated(&mut self, violation: Violation) -> NoDelivery {
        match self.state {
            Ok(_) => {
                let _ = self.violated(violation);
                NoDelivery::Ended(End::Violation(violation))
            }
            Err(end) => {
                if let Some(receiver) = receiver_of(&mut self.ring) {
                    receiver.end(true);
                }
                self.fail_calls();
                NoDelivery::Ended(end)
            }
        }
    }

    /// [`Link::is_ready`] on the ring lane.
    pub(super) fn is_ring_ready(&self, words: &impl RingMemory) -> bool {
        let receiver = self.ring_receiver().filter(|_| !self.is_ring_awaited());
        receiver.is_some_and(|it| it.ready(words))
    }

    /// [`Link::ready`] on the ring lane.
    pub(super) fn ready_in_ring(&self, words: &impl RingMemory) -> usize {
        self.ring_receiver().map_or(0, |it| it.waiting(words))
    }

    /// [`Link::release`] on the ring lane.
    pub(super) fn release_to_ring(
        &mut self,
        words: &impl RingMemory,
        sequence: u64,
    ) -> Result<bool, Error> {
        let Some(receiver) = receiver_of(&mut self.ring) else {
            return Err(Misuse::WrongLane.into());
        };
        let result = match self.state {
            Err(end) => {
                // The sender may not know of the end yet, and still counts what is not back.
                let _ = receiver.release(words, sequence);
                Err(Error::Ended(end))
            }
            Ok(_) => match receiver.release(words, sequence) {
                Some(Ok(bell)) => Ok(bell),
                Some(Err(violation)) => Err(self.violated(violation)),
                None => Err(Misuse::NotBorrowed.into()),
            },
        };
        self.invariants();
        result
    }

    /// [`Link::made_room`] on the ring lane.
    pub(super) fn made_room_in_ring(&self, words: &impl RingMemory) -> bool {
        self.state.is_ok() && self.ring_receiver().is_some() && wants_bell(words, At::SenderParked)
    }

    /// Whether the link's messages go through a ring, once it [is open](Self::is_open).
    #[must_use]
    #[inline]
    pub const fn has_ring(&self) -> bool {
        self.ring.is_some()
    }

    /// Both OPEN offer the ring lane; `window` is that of the other end's.
    //= SM2-RNG-001, SM2-RNG-002
    pub(super) fn agree_on_ring(&mut self, window: u32) {
        let config = &self.config;
        let incoming = config.ring_layout().map(|layout| {
            self.announce_ring = true;
            self.events.push_back(Output::MakeRing(layout));
            let carrier = Carrier::to(config.role);
            RingReceiver::new(layout, carrier, config.reliable, config.max_borrowed)
        });
        let outgoing = Some(Outgoing::Awaited { window });
        let outgoing = outgoing.filter(|_| config.role.sends());
        self.ring = Some(Ring::new(outgoing, incoming));
    }

    /// RING came.
    //= SM2-RNG-002
    pub(super) fn on_ring(
        &mut self,
        depth: u16,
        window: u32,
        fds: &[FdFacts],
    ) -> Result<(), Violation> {
        let facts = fds.first().ok_or(violation!(FdCount, "SM2-TRN-005"))?;
        let layout = RingLayout::new(depth, window);
        Verified::ring(facts, layout)?;
        let carrier = Carrier::to(self.config.role.counterpart());
        match (
            self.ring.as_mut().and_then(|it| it.outgoing.as_mut()),
            layout,
        ) {
            (Some(outgoing @ Outgoing::Awaited { .. }), Some(layout))
                if outgoing.awaits(window) =>
            {
                let sender = RingSender::new(layout, carrier, self.config.reliable);
                *outgoing = Outgoing::Here(sender);
                self.events.push_back(Output::Ring(layout));
                Ok(())
            }
            _ => Err(violation!(BadRing, "SM2-RNG-002")),
        }
    }

    /// DETACHED came.
    //= SM2-RNG-010
    pub(super) fn on_detached(&mut self, segment: u32) -> Result<(), Violation> {
        let sender = sender_of(&mut self.ring);
        sender.map_or(Err(violation!(UnknownSegment, "SM2-RNG-010")), |it| {
            it.detached(segment)
        })
    }

    /// Whether the application holds a message of the ring in this segment.
    pub(super) fn ring_holds(&self, segment: u32) -> bool {
        self.ring_receiver().is_some_and(|it| it.holds(segment))
    }

    fn ring_receiver(&self) -> Option<&RingReceiver> {
        self.ring.as_ref()?.incoming.as_ref()
    }

    /// The next frame of the ring lane that has to go out by the socket.
    //= SM2-RNG-002, SM2-RNG-010
    pub(super) fn transmit_ring(&mut self) -> Option<Packet> {
        let ring = self.ring.as_mut()?;
        if let Some(receiver) = ring.incoming.as_ref().filter(|_| self.announce_ring) {
            self.announce_ring = false;
            let layout = receiver.layout();
            let (depth, window) = (layout.depth(), layout.window());
            return Some(Packet {
                attachment: Some(Attachment::Ring),
                ..Packet::bare(Frame::Ring { depth, window }.head())
            });
        }
        if let Some(segment) = self.detached.pop_front() {
            return Some(Packet::bare(Frame::Detached { segment }.head()));
        }
        Some(match ring.sender_mut()?.poll()? {
            Step::Attach(info) => Packet {
                attachment: Some(Attachment::Segment(info.id)),
                ..Packet::bare(Frame::Attach(info).head())
            },
            Step::Detach(segment) => Packet::bare(Frame::Detach { segment }.head()),
        })
    }
}
