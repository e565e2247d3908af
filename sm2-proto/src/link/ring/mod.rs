//! The ring lane of a link: SPEC section 8.5.
//!
//! A ring is a file of words that both ends map for writing. This module decides what is
//! written where and judges all that is read; it reaches the words through [`Words`], three
//! atomic operations and a fence, which the driver lends for the time of a call. Whatever the
//! other end writes there leads to a message, to nothing, or to a violation.
//!
//! A link of a topic has one ring. One of a service has two, and each call says which one it
//! needs: *outgoing* carries what this end sends, *incoming* what it receives.
//!
//! | a sender's driver | calls, with the outgoing ring |
//! | --- | --- |
//! | before a segment's first message | [`Input::Attach`](super::Input::Attach), and drains |
//! | for each message | [`Link::ring_send`], after writing payload and [`SlotHead`] |
//! | to learn what came back | [`Link::ring_harvest`] |
//! | before it waits for room | [`Link::ring_park`], and looks again |
//!
//! | a receiver's driver | calls, with the incoming ring |
//! | --- | --- |
//! | for the next message | [`Link::ring_take`]; [`Link::ring_peek`] before it says what to prefetch |
//! | when the application gives one back | [`Link::ring_release`] |
//! | before it sleeps | [`Link::ring_park`], and looks again |
//!
//! A caller's or server's driver does what a receiver's does, and what a sender's does, but for
//! this: [`Link::ring_send`] takes every message, and attaches segments as need be. After it and
//! after each other change the driver drains, and as long as [`Link::ring_is_due`] says so it
//! harvests, which sends what waits, and drains. Nobody parks for room: the machine does, as long
//! as there is none.
//!
//! Where a call says that the other end wants the bell, the driver sends [`doorbell`] and does
//! not care whether the socket takes it.

#[cfg(any(kani, test))]
mod proofs;
mod receiver;
mod rings;
mod sender;
mod service;
mod word;

use self::rings::Outgoing;
pub(super) use self::{
    receiver::{NotTaken, RingReceiver},
    rings::{Ring, receiver_of, sender_of},
    sender::{RingSender, Step, Unsent},
};
pub use self::{
    sender::RingMessage,
    word::{At, EMPTY, NotAWord, RingLayout, SlotHead, Word},
};
use super::{
    Attachment, Delivery, End, Error, Fate, Frame, Head, Link, Misuse, Output, Packet, Role,
    TooManyBorrowed, segments::Verified, wire::Carrier,
};
use crate::{Farewell, FdFacts, Violation, limits::SLOT_HEAD};

/// How many messages may be displaced in a row before the receiver counts as stopped. Then the
/// low halves of sequence numbers still tell how often the sender went round.
//= SM2-RNG-011
const DISPLACED_MAX: u32 = 1 << 31;

/// The words of one ring, in memory that the other end writes too.
///
/// All of it is atomic. [`load`](Self::load) acquires; [`swap`](Self::swap) and
/// [`take`](Self::take) acquire and release. What is not a word of the ring's
/// [layout](RingLayout) is never asked for.
pub trait Words {
    /// Reads a word.
    fn load(&self, at: At) -> u64;
    /// Writes a word, and gives the one that was there.
    fn swap(&self, at: At, bits: u64) -> u64;
    /// Writes [`EMPTY`] if `bits` are still there; whether they were.
    fn take(&self, at: At, bits: u64) -> bool;
    /// A sequentially consistent fence.
    fn fence(&self);
}

/// Why [`Link::ring_take`] gives no message, although there may be one.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum NoDelivery {
    /// The application holds all that it may.
    #[error(transparent)]
    TooManyBorrowed(TooManyBorrowed),
    /// The message is in a segment that is not attached: feed all datagrams that are there, and
    /// try again. If none is there, close the link by [`Link::ring_unknown_segment`].
    #[error("the message is in a segment that is not attached yet")]
    UnknownSegment,
    /// The link is over, perhaps by a violation that was just found.
    #[error(transparent)]
    Ended(End),
    /// The link has no ring, or not this end of one.
    #[error(transparent)]
    Misuse(Misuse),
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
fn wants_bell(words: &impl Words, parked: At) -> bool {
    // Pairs with the fence of who parks: it sees our word when it looks again, or we see that it parked.
    words.fence();
    words.load(parked) != EMPTY && words.swap(parked, EMPTY) == 1
}

impl Link {
    /// Sends a message on the ring lane; whether the receiver wants the bell. `settled` hears of
    /// messages that are settled by this, as [`Output::Settled`] says it for the socket lane.
    ///
    /// # Errors
    /// [`Error::Misuse`]: nothing was sent. [`Misuse::NoRoom`]: only reliable links, and all while
    /// a packet is blocked. [`Error::Ended`]: if the link was over before, nothing was sent; else
    /// it is over by this, since the receiver broke SPEC or does not run (SM2-RNG-011), and the
    /// outputs settle also this message.
    pub fn ring_send(
        &mut self,
        words: &impl Words,
        message: &RingMessage,
        mut settled: impl FnMut(u64, Fate),
    ) -> Result<bool, Error> {
        if let Err(end) = self.state {
            return Err(Error::Ended(end));
        }
        if self.has_calls() {
            return self.ring_queue(words, message, &mut settled);
        }
        let Some(sender) = sender_of(&mut self.ring) else {
            return Err(Misuse::WrongLane.into());
        };
        if self.blocked {
            return Err(Misuse::NoRoom.into());
        }
        let result = match sender.send(words, message, &mut settled) {
            Ok(bell) => Ok(bell),
            Err(Unsent::Misuse(misuse)) => Err(misuse.into()),
            Err(Unsent::Violation(violation)) => Err(self.violated(violation)),
            Err(Unsent::Stopped) => {
                let end = End::Local(Farewell::Stalled.code());
                self.finish(end);
                Err(Error::Ended(end))
            }
        };
        self.invariants();
        result
    }

    /// Takes back what the receiver gave back, as far as it is there, and sends what waits, as far
    /// as there is room; whether the receiver wants the bell.
    ///
    /// # Errors
    /// As [`ring_send`](Self::ring_send).
    pub fn ring_harvest(
        &mut self,
        words: &impl Words,
        mut settled: impl FnMut(u64, Fate),
    ) -> Result<bool, Error> {
        if let Err(end) = self.state {
            return Err(Error::Ended(end));
        }
        let Some(sender) = sender_of(&mut self.ring) else {
            return Err(Misuse::WrongLane.into());
        };
        let harvested = sender.harvest(words, &mut settled);
        let result = harvested
            .and_then(|()| self.send_waiting(words, &mut settled))
            .map_err(|violation| self.violated(violation));
        self.invariants();
        result
    }

    /// Whether one more message would neither displace another nor be refused.
    pub fn ring_has_room(&self, words: &impl Words) -> bool {
        let room = |sender: &RingSender| match self.has_calls() {
            true => self.placed.check().is_ok(),
            false => !self.blocked && sender.has_room(words),
        };
        self.state.is_ok() && self.ring.as_ref().and_then(Ring::sender).is_some_and(room)
    }

    /// A publication goes without this link, which has no room for it at this moment: it counts
    /// as [`Fate::Overwritten`].
    ///
    /// # Errors
    /// [`Misuse::WrongLane`].
    pub fn ring_pass_over(&mut self) -> Result<(), Misuse> {
        match sender_of(&mut self.ring) {
            Some(sender) if self.config.role == Role::Sender => {
                sender.skip(Fate::Overwritten);
                Ok(())
            }
            _ => Err(Misuse::WrongLane),
        }
    }

    /// The next message for the application, the oldest first; none if none is there. `head`
    /// copies the last 64 bytes of a slot: it gets the segment's number, the slot's offset and
    /// its length in bytes, and says none if it does not have the segment. The message is the
    /// application's until [`ring_release`](Self::ring_release).
    ///
    /// # Errors
    /// See [`NoDelivery`].
    #[inline]
    pub fn ring_take(
        &mut self,
        words: &impl Words,
        head: impl FnOnce(u32, u64, u64) -> Option<[u8; SLOT_HEAD]>,
    ) -> Result<Option<Delivery>, NoDelivery> {
        let is_awaited = self.is_ring_awaited();
        let Some(receiver) = receiver_of(&mut self.ring) else {
            return Err(NoDelivery::Misuse(Misuse::WrongLane));
        };
        //= SM2-RNG-002
        if is_awaited {
            return Ok(None);
        }
        let inbound = &self.inbound;
        let taken = receiver.take(words, |segment| inbound.geometry(segment), head);
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

    /// Where the next message seems to be: its segment, the offset of its slot and that one's
    /// length in bytes. Nothing is checked but that there is such a slot, and nothing follows from it:
    /// it is for who wants to tell the processor what is read next.
    #[inline]
    pub fn ring_peek(&self, words: &impl Words) -> Option<(u32, u64, u64)> {
        let word = self.ring_receiver()?.peek(words)?;
        let geometry = self.inbound.geometry(word.segment.into())?;
        let offset = geometry.offset(word.slot.into())?;
        Some((word.segment.into(), offset, geometry.stride()))
    }

    /// No datagram is there that could attach the segment of the message.
    //= SM2-RNG-007
    pub fn ring_unknown_segment(&mut self) {
        let _ = self.ring_violated(violation!(UnknownSegment, "SM2-RNG-007"));
        self.invariants();
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

    /// Whether [`ring_take`](Self::ring_take) may give a message.
    pub fn ring_ready(&self, words: &impl Words) -> bool {
        let receiver = self.ring_receiver().filter(|_| !self.is_ring_awaited());
        receiver.is_some_and(|it| it.ready(words))
    }

    /// How many messages are there to take, at most.
    pub fn ring_waiting(&self, words: &impl Words) -> usize {
        self.ring_receiver().map_or(0, |it| it.waiting(words))
    }

    /// The application gives back a message that it took; whether the sender wants the bell.
    ///
    /// # Errors
    /// As [`handle`](Self::handle) of [`Input::Release`](super::Input::Release).
    pub fn ring_release(&mut self, words: &impl Words, sequence: u64) -> Result<bool, Error> {
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

    /// After a reliable receiver took a message: whether the sender wants the bell.
    pub fn ring_made_room(&self, words: &impl Words) -> bool {
        self.config.reliable
            && self.state.is_ok()
            && self.ring_receiver().is_some()
            && wants_bell(words, At::SenderParked)
    }

    /// This end is about to sleep until the bell rings. The driver looks at the ring once more
    /// before it does.
    //= SM2-RNG-009
    pub fn ring_park(&self, words: &impl Words) {
        if let Some(parked) = self.parked_word() {
            words.swap(parked, 1);
            // Pairs with the fence of who puts a word.
            words.fence();
        }
    }

    /// This end does not sleep any more, with none of its threads.
    pub fn ring_unpark(&self, words: &impl Words) {
        if let Some(parked) = self.parked_word() {
            words.swap(parked, EMPTY);
        }
    }

    /// Of a caller or server: in its incoming ring.
    fn parked_word(&self) -> Option<At> {
        match self.ring.as_ref()? {
            Ring {
                incoming: Some(_), ..
            } => Some(At::ReceiverParked),
            ring => ring.sender().map(|_| At::SenderParked),
        }
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
