//! Taking the messages of a link, and giving them back, on whichever lane its machine has agreed
//! on.

use std::mem;
use std::sync::Arc;

use sm2_proto::control::LinkPeer;
use sm2_proto::link::{Delivery, Error, Input, Misuse, NoDelivery, Payload, Role, TooManyBorrowed};
use sm2_proto::{Instant, Machine};

use super::LinkDriver;
use super::account::Before;
use crate::driver::context::Context;
use crate::driver::counters::{count_taken, update};
use crate::driver::event_sets::LinkSets;
use crate::driver::interface::{Header, Taken};
use crate::driver::origin::Held;
use crate::driver::outbox::Outbox;
use crate::driver::token::LinkToken;
use crate::payload::Source;

/// The next message of a link.
#[derive(Debug)]
#[allow(
    clippy::large_enum_variant,
    reason = "few messages expire, and a box would need an allocation"
)]
enum Next {
    /// The application has it.
    Put,
    /// It is older than its lifespan.
    Expired(Delivery<()>),
}

impl LinkDriver {
    /// Takes the next message for the application, and passes it to `put`. Before that, passes to `count` its header
    /// and how many of the lost messages were published while there was no link. Returns whether there was a message.
    #[inline]
    pub(in crate::driver) fn take(
        &mut self,
        count: &mut impl FnMut(&Header, u64, &Arc<LinkPeer>),
        put: &mut impl FnMut(Taken),
        context: &mut Context<'_>,
        outbox: &mut Outbox,
    ) -> Result<bool, TooManyBorrowed> {
        let mut looked = false;
        loop {
            match self.take_next(count, put, context.now) {
                Ok(Some(next)) => {
                    // The parked word is not cleared, because another thread of this subscriber may
                    // sleep.
                    let wake = self.machine.made_room(&self.mapped);
                    self.wake(wake, context.sets);
                    // There may be outputs for cancelled or failed calls.
                    self.drain_if_due(context.sets, outbox);
                    if let Next::Expired(delivery) = next {
                        self.drop_taken(&delivery, context, outbox);
                        continue;
                    }
                    if self.end().is_some() {
                        self.forget_unused();
                    }
                    return Ok(true);
                }
                Ok(None) => {
                    self.drain_if_due(context.sets, outbox);
                    return Ok(false);
                }
                Err(NoDelivery::TooManyBorrowed(error)) => return Err(error),
                //= SM2-RNG-007
                Err(NoDelivery::UnknownSegment) if !looked && self.end().is_none() => {
                    looked = true;
                    self.receive_all(context, outbox);
                    context.socket_read = true;
                    // One of these datagrams may have been a DOORBELL, and another thread may be
                    // about to sleep.
                    self.park();
                }
                // The ATTACH may be among the datagrams that could not be read.
                Err(NoDelivery::UnknownSegment) if self.is_short_of_memory() => return Ok(false),
                Err(NoDelivery::UnknownSegment) => {
                    let now = sm2_io::clock::now();
                    // This input ends the link, which the outputs report.
                    let _ = self.machine.handle(now, Input::SegmentMissing);
                    break;
                }
                Err(NoDelivery::Ended(_) | NoDelivery::Misuse(_)) => break,
            }
        }
        self.drain_idle(context.sets, outbox);
        Ok(false)
    }

    /// Takes the next message. Passes it, with the memory of its payload, to `put`, unless it is older than its
    /// lifespan.
    #[inline]
    fn take_next(
        &mut self,
        count: &mut impl FnMut(&Header, u64, &Arc<LinkPeer>),
        put: &mut impl FnMut(Taken),
        now: Instant,
    ) -> Result<Option<Next>, NoDelivery> {
        let lifespan = self.machine.config().lifespan;
        let is_topic = self.role() == Role::Receiver;
        self.machine.take_with(&self.mapped, |delivery| {
            //= SM2-QOS-010
            if lifespan.has_passed_by(delivery.time, sm2_io::clock::now) {
                return Next::Expired(delivery.map_cell(drop));
            }
            let mut header = Header::of(&delivery);
            header.lost = (header.lost).saturating_add(mem::take(&mut self.lost_with_expired));
            let is_released = !matches!(delivery.payload, Payload::Cell(_));
            self.held += usize::from(is_released);
            self.received.add(&header);
            if is_topic {
                let held = self.held as u64;
                count_taken(self.counting.entry.as_mut(), now, &header, |entry| {
                    entry.held(held)
                });
            }
            let Before { away, unreported } =
                (self.account).take(&mut header, delivery.lost, self.counting.entry.as_mut());
            count(&header, away, &self.origin.peer);
            header.lost = header.lost.saturating_add(unreported);
            let link = || Held::Link(Arc::clone(&self.origin));
            let len = header.len;
            let (origin, source) = match delivery.payload {
                Payload::Inline(bytes) => (link(), Source::Inline(bytes)),
                Payload::Cell(cell) => {
                    let copy = self.cells.copy(cell, &self.origin);
                    (Held::Cell(copy), Source::Cell)
                }
                Payload::Pooled { segment, offset } => match self.mapped.segments.get(segment) {
                    Some(segment) => {
                        let held = Held::Segment(Arc::clone(segment));
                        (held, Source::Pooled { offset, len })
                    }
                    None => (link(), Source::Missing),
                },
                Payload::Sealed => match self.kept.remove(&header.sequence) {
                    Some(file) => {
                        let quota = Arc::clone(&self.quota);
                        (link(), Source::Sealed { file, len, quota })
                    }
                    None => (link(), Source::Missing),
                },
            };
            debug_assert!(!matches!(source, Source::Missing), "{header:?}");
            put(Taken {
                origin,
                header,
                source,
            });
            Next::Put
        })
    }

    /// Gives the messages at these places of this link back for the application, as one batch.
    //= SM2-RNG-008, SM2-RNG-012, SM2-MSG-005
    #[inline]
    pub(in crate::driver) fn release(
        &mut self,
        batch: &[(LinkToken, u64)],
        sets: &LinkSets,
        outbox: &mut Outbox,
    ) {
        self.held = self.held.saturating_sub(batch.len());
        let sequences = batch.iter().map(|it| it.1);
        let released = self.machine.release_all(&self.mapped, sequences);
        debug_assert!(
            !matches!(released, Err(Error::Misuse(Misuse::NotBorrowed))),
            "{batch:?} on {}",
            self.id
        );
        self.wake(released.unwrap_or_default(), sets);
        if self.role() == Role::Receiver {
            update(self.counting.entry.as_mut(), |entry| {
                entry.held(self.held as u64)
            });
        }
        self.drain_if_due(sets, outbox);
    }
}
