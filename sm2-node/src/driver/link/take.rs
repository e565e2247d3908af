//! Taking the messages of a link, and giving them back, on whichever lane its machine has agreed
//! on.

use std::sync::Arc;

use sm2_proto::Machine;
use sm2_proto::link::{Delivery, Error, Input, Misuse, NoDelivery, Payload, TooManyBorrowed};

use super::LinkDriver;
use crate::driver::context::Context;
use crate::driver::event_sets::LinkSets;
use crate::driver::outbox::Outbox;
use crate::payload::Source;

impl LinkDriver {
    /// Takes the next message for the application. Returns it with the memory of its payload.
    #[inline]
    pub(in crate::driver) fn take(
        &mut self,
        context: &mut Context<'_>,
        outbox: &mut Outbox,
    ) -> Result<Option<(Delivery, Source)>, TooManyBorrowed> {
        let Some(delivery) = self.take_in_time(context, outbox)? else {
            return Ok(None);
        };
        let source = self.source(&delivery);
        self.held += 1;
        self.received.add(&delivery);
        if self.end().is_some() {
            self.forget_unused();
        }
        Ok(Some((delivery, source)))
    }

    /// Takes the next message for the application, whatever its age.
    #[inline]
    pub(super) fn take_next(
        &mut self,
        context: &mut Context<'_>,
        outbox: &mut Outbox,
    ) -> Result<Option<Delivery>, TooManyBorrowed> {
        for looked in [false, true] {
            self.prefetch_next();
            match self.machine.take(&self.mapped) {
                Ok(taken) => {
                    // The parked word is not cleared, because another thread of this subscriber may
                    // sleep.
                    if taken.is_some() {
                        let wake = self.machine.made_room(&self.mapped);
                        self.wake(wake, context.sets);
                    }
                    // There may be outputs for cancelled or failed calls.
                    self.drain_if_due(context.sets, outbox);
                    return Ok(taken);
                }
                Err(NoDelivery::TooManyBorrowed(error)) => return Err(error),
                //= SM2-RNG-007
                Err(NoDelivery::UnknownSegment) if !looked && self.end().is_none() => {
                    self.receive_all(context, outbox);
                    context.stirred = true;
                    // One of these datagrams may have been a DOORBELL, and another thread may be
                    // about to sleep.
                    self.park();
                }
                // The ATTACH may be among the datagrams that could not be read.
                Err(NoDelivery::UnknownSegment) if self.short_of_memory => return Ok(None),
                Err(NoDelivery::UnknownSegment) => {
                    let now = sm2_io::clock::now();
                    // This input ends the link, which the outputs report.
                    let _ = self.machine.handle(now, Input::SegmentMissing);
                }
                Err(NoDelivery::Ended(_) | NoDelivery::Misuse(_)) => break,
            }
        }
        self.drain_idle(context.sets, outbox);
        Ok(None)
    }

    /// Prefetches the lines that are read after the next word was taken. The processor executes no
    /// read before the atomic operation that takes the word, and these lines are in the cache of
    /// the sender's core. The prefetch overlaps their transfer with the atomic operation.
    #[inline]
    fn prefetch_next(&self) {
        if let Some(slot) = self.machine.peek(&self.mapped)
            && let Some(mapping) = self.mapped.segments.get(slot.segment)
        {
            mapping.prefetch(slot.head_offset());
            mapping.prefetch(slot.offset);
        }
    }

    #[inline]
    fn source(&mut self, delivery: &Delivery) -> Source {
        let found = match &delivery.payload {
            Payload::Inline(bytes) => Some(Source::Inline(bytes.clone())),
            Payload::Pooled { segment, offset } => {
                self.mapped.segments.get(*segment).map(|it| Source::Pooled {
                    segment: Arc::clone(it),
                    offset: *offset,
                    len: delivery.len,
                })
            }
            Payload::Sealed => self.kept.remove(&delivery.sequence).map(|file| {
                let (len, quota) = (delivery.len, Arc::clone(&self.quota));
                Source::Sealed { file, len, quota }
            }),
        };
        debug_assert!(found.is_some(), "{delivery:?}");
        found.unwrap_or(Source::Missing)
    }

    /// Gives a message back for the application.
    //= SM2-RNG-016, SM2-MSG-005
    pub(in crate::driver) fn release(
        &mut self,
        sequence: u64,
        sets: &LinkSets,
        outbox: &mut Outbox,
    ) {
        self.note_released();
        let released = self.machine.release(&self.mapped, sequence);
        debug_assert!(
            !matches!(released, Err(Error::Misuse(Misuse::NotBorrowed))),
            "{sequence} on {}",
            self.id
        );
        self.wake(released.unwrap_or_default(), sets);
        self.drain_if_due(sets, outbox);
    }

    /// Counts a message that the application gave back.
    const fn note_released(&mut self) {
        self.held = self.held.saturating_sub(1);
    }
}
