//! Sending, taking and releasing the messages of one link, on whichever lane its machine has agreed
//! on.
//!
//! The driver lends the memory that both sides map to the machine for each call: [`Mapped`].

use std::collections::BTreeMap;
use std::io::{self, IoSlice};
use std::os::fd::OwnedFd;
use std::sync::Arc;

use sm2_io::{Epoll, InspectedFd, PooledMapping, Ring};
use sm2_proto::link::{
    self, Delivery, Error, Input, LinkMemory, Misuse, NoDelivery, RingLayout, Role, SlotRange,
    Status, TooManyBorrowed, Wake, doorbell,
};
use sm2_proto::{Farewell, Machine, limits::SLOT_HEAD};

use super::link::{LinkDriver, Tools};
use super::message_key::MessageKey;
use super::outbox::{NoForm, Outbox};

/// The memory of a link that both sides map.
#[derive(Debug, Default)]
pub(super) struct Mapped {
    /// The ring that this side takes messages from.
    pub(super) incoming: Option<Ring>,
    /// The ring that this side sends through.
    pub(super) outgoing: Option<Ring>,
    /// The segments of the other side.
    pub(super) segments: BTreeMap<u32, Arc<PooledMapping>>,
}

impl LinkMemory for Mapped {
    type Ring = Ring;

    #[inline]
    fn outgoing(&self) -> Option<&Ring> {
        self.outgoing.as_ref()
    }

    #[inline]
    fn incoming(&self) -> Option<&Ring> {
        self.incoming.as_ref()
    }

    #[inline]
    fn slot_head(&self, slot: SlotRange) -> Option<[u8; SLOT_HEAD]> {
        let segment = self.segments.get(&slot.segment)?;
        segment.copy::<SLOT_HEAD>(slot.head_offset())
    }
}

/// Creates the ring from which this side will take messages, before this side offers the ring lane.
/// A process without a free descriptor uses the socket lane.
//= SM2-RNG-002
pub(super) fn prepare_ring(config: &mut link::Config) -> Option<(Ring, OwnedFd)> {
    if !config.ring || config.sealed {
        return None;
    }
    let layout = config.ring_layout()?;
    match Ring::create(layout) {
        Ok(made) => Some(made),
        Err(error) => {
            tracing::debug!(link = %config.id, %error, "no ring: the socket lane is used");
            config.ring = false;
            None
        }
    }
}

impl LinkDriver {
    /// Maps the ring that the other side created.
    pub(super) fn map_ring(&mut self, layout: RingLayout, fd: Option<InspectedFd>) {
        let mapped = fd
            .ok_or_else(|| io::Error::from(io::ErrorKind::NotFound))
            .and_then(|fd| fd.into_ring().map_err(io::Error::other))
            .and_then(|file| Ring::map(&file, layout));
        match mapped {
            Ok(ring) => self.mapped.outgoing = Some(ring),
            Err(error) => self.fail(Farewell::Resources, &error),
        }
    }

    /// Whether each message makes the link's socket readable.
    pub(crate) const fn is_woken_by_socket(&self) -> bool {
        self.machine.is_woken_by_socket()
    }

    /// Sends a message that the outbox holds. If there is no slot or no room for a publication at
    /// this moment, the publication is not sent on this link. If memory for a message is missing
    /// for another reason, the link ends, because it would miss a message that other links get.
    pub(super) fn send(
        &mut self,
        key: MessageKey,
        status: Status,
        tools: &mut Tools<'_>,
        outbox: &mut Outbox,
    ) {
        for is_last in [false, true] {
            if self.machine.end().is_some() {
                return;
            }
            let message = match outbox.message(key, status, self.machine.placement()) {
                Ok(message) => message,
                Err(error) => return self.without_form(&error, tools, outbox),
            };
            let segment = match &message.body {
                link::Body::Pooled { segment, .. } => Some(*segment),
                link::Body::Inline(_) | link::Body::Sealed => None,
            };
            // The call itself may settle the message, so the link holds it before the call.
            outbox.hold(key);
            let settled = |key, fate| outbox.settle(MessageKey::from_raw(key), fate);
            let misuse = match self.machine.send(&self.mapped, message, settled) {
                Ok(wake) => return self.note_and_finish(key, wake, tools, outbox),
                // The outputs settle the message with all others.
                Err(Error::Ended(_)) => return self.drain_idle(tools.epoll, outbox),
                Err(Error::Misuse(misuse)) => misuse,
            };
            outbox.release(key);
            match (misuse, segment) {
                (Misuse::NotAttached, Some(segment)) if !is_last => {
                    self.feed(Input::Attach(segment), tools.epoll, outbox);
                }
                _ => return self.without_room(misuse, tools, outbox),
            }
        }
    }

    /// Completes the sending of a message that the machine has accepted.
    fn note_and_finish(
        &mut self,
        key: MessageKey,
        wake: Wake,
        tools: &mut Tools<'_>,
        outbox: &mut Outbox,
    ) {
        self.wake(wake);
        self.drain_if_due(tools.epoll, outbox);
        if self.machine.is_due() {
            self.harvest(tools, outbox);
        }
        if let Some(label) = outbox.label(key) {
            self.note_sent(label.time, label.len, tools.counting);
        }
    }

    /// Handles a message that cannot be put into the form that this link needs.
    fn without_form(&mut self, error: &NoForm, tools: &mut Tools<'_>, outbox: &mut Outbox) {
        let peer = &self.peer.name;
        if matches!(error, NoForm::Slot(_)) && self.role() == Role::Sender {
            tracing::warn!(link = %self.id, %peer, %error, "no slot for a message");
            return self.pass_over(tools, outbox);
        }
        tracing::warn!(link = %self.id, %peer, %error, "no memory for a message");
        let code = Farewell::Resources.code();
        self.feed(Input::Close(code), tools.epoll, outbox);
    }

    fn without_room(&mut self, misuse: Misuse, tools: &mut Tools<'_>, outbox: &mut Outbox) {
        debug_assert!(
            matches!(
                misuse,
                Misuse::NoRoom | Misuse::NotAttached | Misuse::SegmentBusy
            ),
            "{misuse} on {}",
            self.id
        );
        if self.role() == Role::Sender {
            self.pass_over(tools, outbox);
        }
    }

    fn pass_over(&mut self, tools: &mut Tools<'_>, outbox: &mut Outbox) {
        self.feed(Input::PassOver, tools.epoll, outbox);
        self.note_fates(tools.counting);
    }

    /// Settles the messages that the receiver gave back, and sends queued messages into the new
    /// room.
    pub(super) fn harvest(&mut self, tools: &mut Tools<'_>, outbox: &mut Outbox) {
        while self.machine.end().is_none() {
            let settled = |key, fate| outbox.settle(MessageKey::from_raw(key), fate);
            let harvested = self.machine.harvest(&self.mapped, settled);
            self.wake(harvested.unwrap_or_default());
            self.drain_if_due(tools.epoll, outbox);
            if !self.machine.is_due() {
                break;
            }
        }
        self.note_fates(tools.counting);
    }

    /// Sends queued messages after a change that may let them through: a freed segment number, a
    /// writable socket, or room.
    pub(super) fn send_waiting(&mut self, tools: &mut Tools<'_>, outbox: &mut Outbox) {
        if self.machine.is_waiting() {
            self.harvest(tools, outbox);
        }
    }

    /// Takes the next message for the application.
    #[inline]
    pub(super) fn take_next(
        &mut self,
        tools: &mut Tools<'_>,
        outbox: &mut Outbox,
    ) -> Result<Option<Delivery>, TooManyBorrowed> {
        for looked in [false, true] {
            self.prefetch_next();
            match self.machine.take(&self.mapped) {
                Ok(taken) => {
                    // The parked word is not cleared, because another thread of this subscriber may
                    // sleep.
                    if taken.is_some() {
                        self.wake(self.machine.made_room(&self.mapped));
                    }
                    // There may be outputs for cancelled or failed calls.
                    self.drain_if_due(tools.epoll, outbox);
                    return Ok(taken);
                }
                Err(NoDelivery::TooManyBorrowed(error)) => return Err(error),
                //= SM2-RNG-007
                Err(NoDelivery::UnknownSegment) if !looked && self.end().is_none() => {
                    self.receive_all(tools, outbox);
                    tools.stirred = true;
                    // One of these datagrams may have been a DOORBELL, and another thread may be
                    // about to sleep.
                    self.park();
                }
                Err(NoDelivery::UnknownSegment) => {
                    let now = sm2_io::clock::now();
                    // This input ends the link, which the outputs report.
                    let _ = self.machine.handle(now, Input::SegmentMissing);
                }
                Err(NoDelivery::Ended(_) | NoDelivery::Misuse(_)) => break,
            }
        }
        self.drain_idle(tools.epoll, outbox);
        Ok(None)
    }

    /// Prefetches the lines that are read after the next word was taken. The processor executes no
    /// read before the atomic operation that takes the word, and these lines are in the cache of
    /// the sender's core. The prefetch overlaps their transfer with the atomic operation.
    #[inline]
    fn prefetch_next(&self) {
        if let Some(slot) = self.machine.peek(&self.mapped)
            && let Some(mapping) = self.mapped.segments.get(&slot.segment)
        {
            mapping.prefetch(slot.head_offset());
            mapping.prefetch(slot.offset);
        }
    }

    /// Gives a message back for the application.
    //= SM2-RNG-008, SM2-MSG-005
    pub(super) fn release(&mut self, sequence: u64, epoll: &Epoll, outbox: &mut Outbox) {
        self.note_released();
        let released = self.machine.release(&self.mapped, sequence);
        debug_assert!(
            !matches!(released, Err(Error::Misuse(Misuse::NotBorrowed))),
            "{sequence} on {}",
            self.id
        );
        self.wake(released.unwrap_or_default());
        self.drain_if_due(epoll, outbox);
    }

    /// Drains the machine if it may have outputs.
    #[inline]
    fn drain_if_due(&mut self, epoll: &Epoll, outbox: &mut Outbox) {
        if self.machine.has_output() {
            self.drain_idle(epoll, outbox);
        }
    }

    /// Announces that a thread is about to sleep until this link has an event.
    //= SM2-RNG-009
    pub(super) fn park(&self) {
        if self.machine.end().is_none() {
            self.machine.park(&self.mapped);
        }
    }

    /// Wakes the other side if that is needed. If the socket is full, it is readable at the other
    /// end, so the other side is awake or will wake.
    //= SM2-RNG-009
    #[inline]
    pub(super) fn wake(&self, wake: Wake) {
        if wake.is_needed()
            && let Some(socket) = &self.socket
        {
            let _ = socket.send(&[IoSlice::new(&doorbell())], &[]);
        }
    }
}
