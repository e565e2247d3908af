//! Messages that are sent through a ring.

use super::super::{
    At, CELL_WORDS, CellView, Delivery, End, Error, Fate, Link, LinkMemory, Misuse, NoDelivery,
    RingMemory, Wake,
    lane::Lane,
    machine::Over,
    ring::{
        CellMessage, NotReleased, NotTaken, RingMessage, RingSendError, TakenMessage, wake_parked,
    },
    wire::Given,
};
use crate::{Farewell, Violation};

impl Link {
    /// [`Link::send`] on the ring lane.
    #[inline]
    pub(super) fn send_by_ring(
        &mut self,
        memory: &impl LinkMemory,
        message: &RingMessage,
        settled: &mut impl FnMut(u64, Fate),
    ) -> Result<Wake, Error> {
        let words = memory.outgoing().ok_or(Misuse::NotLent)?;
        if self.has_calls() {
            return self.queue_for_ring(words, message, settled);
        }
        let Lane::Ring(ring) = &mut self.lane else {
            return Err(Misuse::NotOpen.into());
        };
        let sender = ring.sender_mut().ok_or(Misuse::NotOpen)?;
        if self.blocked {
            return Err(Misuse::NoRoom.into());
        }
        let sent = sender.send(words, message, settled);
        self.sent_by_ring(sent)
    }

    /// [`Link::send_in_cell`] on an open link.
    #[inline]
    pub(super) fn send_by_cell(
        &mut self,
        memory: &impl LinkMemory,
        message: &CellMessage<'_>,
        settled: &mut impl FnMut(u64, Fate),
    ) -> Result<Wake, Error> {
        let words = memory.outgoing().ok_or(Misuse::NotLent)?;
        let has_calls = self.has_calls();
        if has_calls {
            self.check_call_in_cell(message.id)?;
        }
        let Lane::Ring(ring) = &mut self.lane else {
            return Err(Misuse::NotOpen.into());
        };
        let sender = ring.sender_mut().ok_or(Misuse::NotOpen)?;
        if self.blocked {
            return Err(Misuse::NoRoom.into());
        }
        let sent = sender.send_in_cell(words, message, settled);
        if has_calls && !matches!(sent, Err(RingSendError::Misuse(_))) {
            ring.queue.note(message.id);
            self.note_sent_call(message.id);
        }
        self.sent_by_ring(sent)
    }

    /// Handles the result of a call of the sender.
    #[inline]
    fn sent_by_ring(&mut self, sent: Result<Wake, RingSendError>) -> Result<Wake, Error> {
        match sent {
            Ok(wake) => Ok(wake),
            Err(RingSendError::Misuse(misuse)) => Err(misuse.into()),
            Err(RingSendError::Violation(violation)) => Err(self.violated(violation)),
            Err(RingSendError::Stopped) => {
                let end = End::Local(Farewell::Stalled.code());
                self.finish(end);
                Err(Error::Ended(end))
            }
        }
    }

    /// [`Link::harvest`] on the ring lane.
    #[inline]
    pub(super) fn harvest_ring(
        &mut self,
        words: &impl RingMemory,
        settled: &mut impl FnMut(u64, Fate),
    ) -> Result<Wake, Error> {
        let Lane::Ring(ring) = &mut self.lane else {
            return Ok(Wake::NotNeeded);
        };
        let harvested = (ring.sender_mut()).map_or(Ok(()), |it| it.harvest(words, settled));
        let result = harvested
            .and_then(|()| self.send_queued(words, settled))
            .map_err(|violation| self.violated(violation));
        self.invariants();
        result
    }

    /// [`Link::take`] on the ring lane.
    #[inline]
    pub(super) fn take_from_ring<M: LinkMemory, R>(
        &mut self,
        memory: &M,
        deliver: impl FnOnce(Delivery<CellView<'_>>) -> R,
    ) -> Result<Option<R>, NoDelivery> {
        let has_calls = self.has_calls();
        let Lane::Ring(ring) = &mut self.lane else {
            return Ok(None);
        };
        let is_awaited = ring.is_awaited();
        let Some(receiver) = &mut ring.incoming else {
            return Err(NoDelivery::Misuse(Misuse::WrongRole));
        };
        let Some(words) = memory.incoming() else {
            return Err(NoDelivery::Misuse(Misuse::NotLent));
        };
        //= SM2-RNG-002
        if is_awaited {
            return Ok(None);
        }
        let geometry = |segment| ring.segments.geometry(segment);
        let prefetch = |slot| memory.prefetch(slot);
        let mut cell = [0; CELL_WORDS];
        let delivery = match receiver.take_word(words, &mut cell, geometry, prefetch) {
            Ok(None) if has_calls => match self.note_call::<CellView<'_>>(None) {
                Ok(()) => return Ok(None),
                Err(violation) => return Err(self.not_taken(violation.into())),
            },
            Ok(None) => return Ok(None),
            Ok(Some(taken)) => {
                if M::PREFETCHES && matches!(taken, TakenMessage::Slot(_)) {
                    receiver.prefetch(words, 1, geometry, prefetch);
                }
                match taken {
                    TakenMessage::Slot(taken) => {
                        receiver.receive(taken, memory.slot_head(taken.slot))
                    }
                    TakenMessage::Cell(word) => receiver.receive_cell(word, &cell),
                }
            }
            Err(why) => return Err(self.not_taken(why)),
        };
        let delivery = match delivery {
            Ok(delivery) => delivery,
            Err(why) => return Err(self.not_taken(why)),
        };
        if has_calls && let Err(violation) = self.note_call(Some(&delivery)) {
            return Err(self.not_taken(violation.into()));
        }
        self.invariants();
        Ok(Some(deliver(delivery)))
    }

    /// [`Link::prefetch`] on the ring lane.
    #[inline]
    pub(super) fn prefetch_from_ring<M: LinkMemory>(&self, memory: &M) {
        if M::PREFETCHES
            && let Lane::Ring(ring) = &self.lane
            && let (Some(receiver), Some(words)) = (&ring.incoming, memory.incoming())
        {
            let geometry = |segment| ring.segments.geometry(segment);
            receiver.prefetch(words, 0, geometry, |slot| memory.prefetch(slot));
        }
    }

    /// Handles the reason why no message is taken.
    #[cold]
    fn not_taken(&mut self, why: NotTaken) -> NoDelivery {
        let result = match why {
            NotTaken::TooManyBorrowed(error) => NoDelivery::TooManyBorrowed(error),
            NotTaken::UnknownSegment => NoDelivery::UnknownSegment,
            NotTaken::Violation(violation) => self.ring_violated(violation),
        };
        self.invariants();
        result
    }

    /// Gives messages back on the ring lane.
    #[inline]
    pub(super) fn release_to_ring(
        &mut self,
        memory: &impl LinkMemory,
        sequences: impl IntoIterator<Item = u64>,
        given: Given,
    ) -> Result<Wake, Error> {
        let Lane::Ring(ring) = &mut self.lane else {
            return Err(Misuse::NotOpen.into());
        };
        let released = match (&mut ring.incoming, memory.incoming()) {
            (Some(receiver), Some(words)) => receiver.release_all(words, sequences, given),
            (Some(_), None) => Err(Misuse::NotLent.into()),
            (None, _) => Err(Misuse::WrongRole.into()),
        };
        let result = match (self.state, released) {
            // The words are put even after the end: the sender may not know of the end, and still
            // counts its unreleased messages.
            (Err(Over { end, .. }), _) => Err(Error::Ended(end)),
            (Ok(_), Ok(wake)) => Ok(wake),
            (Ok(_), Err(NotReleased::Misuse(misuse))) => Err(misuse.into()),
            (Ok(_), Err(NotReleased::Violation(violation))) => Err(self.violated(violation)),
        };
        self.invariants();
        result
    }

    /// Whether the sender has to be woken because [`take`](Self::take) returned one message or more. The sender of a
    /// reliable link waits for room. Any sender may wait until its messages are settled, which those in cells are when
    /// they are taken.
    //= SM2-RNG-012, SM2-RNG-013
    #[inline]
    pub fn made_room(&self, memory: &impl LinkMemory) -> Wake {
        let (Lane::Ring(ring), Some(words)) = (&self.lane, memory.incoming()) else {
            return Wake::NotNeeded;
        };
        match &ring.incoming {
            Some(receiver)
                if self.state.is_ok() && (self.config.reliable || receiver.took_cell) =>
            {
                wake_parked(words, At::SenderParked)
            }
            _ => Wake::NotNeeded,
        }
    }

    /// Handles [`Input::SegmentMissing`](super::super::Input::SegmentMissing), on a live link or
    /// one that is over.
    //= SM2-RNG-007
    pub(in crate::link) fn on_segment_missing(&mut self) {
        if matches!(&self.lane, Lane::Ring(ring) if ring.incoming.is_some()) {
            let _ = self.ring_violated(violation!(UnknownSegment, "SM2-RNG-007"));
        }
    }

    /// Handles a violation that was found in a ring. If the link is already over, the messages that
    /// are left in the ring are dropped.
    fn ring_violated(&mut self, violation: Violation) -> NoDelivery {
        match self.state {
            Ok(_) => {
                let _ = self.violated(violation);
                NoDelivery::Ended(End::Violation(violation))
            }
            Err(Over { end, .. }) => {
                self.end_ring();
                NoDelivery::Ended(end)
            }
        }
    }

    /// Takes no further message from the ring of a link that is over.
    pub(super) fn end_ring(&mut self) {
        if let Lane::Ring(ring) = &mut self.lane
            && let Some(receiver) = &mut ring.incoming
        {
            receiver.end(true);
        }
        self.fail_calls();
    }
}
