//! Messages of one link: sent, taken and given back, on whichever lane its machine has agreed on.
//!
//! The memory that both sides map is lent to the machine for each call: [`Mapped`].

use std::collections::BTreeMap;
use std::io::{self, IoSlice};
use std::os::fd::OwnedFd;
use std::sync::Arc;

use sm2_io::{Epoll, InspectedFd, PooledMapping, Ring};
use sm2_proto::link::{
    self, Delivery, Error, Input, LinkMemory, Misuse, NoDelivery, RingLayout, Role, Status,
    TooManyBorrowed, Wake, doorbell,
};
use sm2_proto::{Farewell, limits::SLOT_HEAD};

use super::link::{LinkDriver, Tools};
use super::message_key::MessageKey;
use super::outbox::{NoForm, Outbox};

/// The memory of a link that both sides map.
#[derive(Debug, Default)]
pub(super) struct Mapped {
    /// The ring that this side takes messages from.
    pub(super) incoming: Option<Ring>,
    /// The ring that this side sends by.
    pub(super) outgoing: Option<Ring>,
    /// The other side's segments.
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
    fn slot_head(&self, segment: u32, offset: u64, stride: u64) -> Option<[u8; SLOT_HEAD]> {
        let segment = self.segments.get(&segment)?;
        segment.copy::<SLOT_HEAD>(offset + stride - SLOT_HEAD as u64)
    }
}

/// Makes the ring that this side will take messages from, before it is offered: a process without a
/// descriptor to spare uses the socket lane.
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
    /// Maps the ring that the other side made.
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

    /// Whether its socket becomes readable with each message.
    pub(crate) const fn is_woken_by_socket(&self) -> bool {
        self.machine.is_woken_by_socket()
    }

    /// Sends a message that the outbox holds. A publication for which there is no slot or no room at
    /// this moment is not sent on this link. If the memory for a message cannot be had otherwise, the
    /// link ends: it would miss a message that others get.
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
            // The call itself may settle the message, so it is held before.
            outbox.hold(key);
            let settled = |key, fate| outbox.settle(MessageKey::from_raw(key), fate);
            let misuse = match self.machine.send(&self.mapped, message, settled) {
                Ok(wake) => return self.note_and_finish(key, wake, tools, outbox),
                // The outputs settle it, as all others.
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

    /// The machine has taken a message.
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

    /// A message cannot be put in the form that this link needs.
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

    /// Takes back what the receiver gave back, and sends what waited for that.
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

    /// Sends what waited for what has just changed: a segment's number, the socket, room.
    pub(super) fn send_waiting(&mut self, tools: &mut Tools<'_>, outbox: &mut Outbox) {
        if self.machine.is_waiting() {
            self.harvest(tools, outbox);
        }
    }

    /// The next message for the application.
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
                    // The parked word stays as it is: another thread of this subscriber may sleep.
                    if taken.is_some() {
                        self.wake(self.machine.made_room(&self.mapped));
                    }
                    // Outputs say that a call is cancelled, or failed.
                    self.drain_if_due(tools.epoll, outbox);
                    return Ok(taken);
                }
                Err(NoDelivery::TooManyBorrowed(error)) => return Err(error),
                //= SM2-RNG-007
                Err(NoDelivery::UnknownSegment) if !looked && self.end().is_none() => {
                    self.receive_all(tools, outbox);
                    tools.stirred = true;
                    // The bell was perhaps among that, and somebody is about to sleep.
                    self.park();
                }
                Err(NoDelivery::UnknownSegment) => {
                    let now = sm2_io::clock::now();
                    // The link is over by this: the outputs say so.
                    let _ = self.machine.handle(now, Input::SegmentMissing);
                }
                Err(NoDelivery::Ended(_) | NoDelivery::Misuse(_)) => break,
            }
        }
        self.drain_idle(tools.epoll, outbox);
        Ok(None)
    }

    /// No read goes ahead of the atomic operation that takes a word. So what is read after it, from lines
    /// that the sender's core has, is fetched while that goes on.
    #[inline]
    fn prefetch_next(&self) {
        if let Some((segment, offset, stride)) = self.machine.peek(&self.mapped)
            && let Some(mapping) = self.mapped.segments.get(&segment)
        {
            mapping.prefetch(offset + stride - SLOT_HEAD as u64);
            mapping.prefetch(offset);
        }
    }

    /// The application gives a message back.
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

    /// Drains the machine, if it may have outputs.
    #[inline]
    fn drain_if_due(&mut self, epoll: &Epoll, outbox: &mut Outbox) {
        if self.machine.has_output() {
            self.drain_idle(epoll, outbox);
        }
    }

    /// Somebody is about to sleep until something happens on this link.
    //= SM2-RNG-009
    pub(super) fn park(&self) {
        if self.machine.end().is_none() {
            self.machine.park(&self.mapped);
        }
    }

    /// Wakes the other side, if that is needed. A socket that takes no more is readable at its other
    /// end, which is awake or will be.
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
