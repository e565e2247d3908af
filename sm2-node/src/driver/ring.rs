//! The ring lane of one link: what goes past its socket.

use std::io::{self, IoSlice};
use std::os::fd::OwnedFd;

use sm2_io::{Epoll, InspectedFd, Ring};
use sm2_proto::link::{
    self, Delivery, Fate, Input, Misuse, NoDelivery, RingLayout, Role, TooManyBorrowed, doorbell,
};
use sm2_proto::{Farewell, limits::SLOT_HEAD};

use super::link::{LinkDriver, Tools};
use super::outbox::Outbox;

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
            Ok(ring) if self.role() == Role::Sender => self.ring = Some(ring),
            Ok(ring) => self.ring_out = Some(ring),
            Err(error) => self.fail(Farewell::Resources, &error),
        }
    }

    /// Whether its messages go through a ring.
    pub(crate) const fn has_ring(&self) -> bool {
        self.machine.has_ring()
    }

    /// Sends a message that the outbox holds. Without room it goes without this link.
    pub(super) fn ring_send(&mut self, key: u64, tools: &mut Tools<'_>, outbox: &mut Outbox) {
        let message = match outbox.ring_message(key) {
            Ok(message) => message,
            Err(error) => {
                tracing::warn!(link = %self.id, peer = %self.peer.name, %error, "no slot for a message");
                return self.ring_pass_over(tools);
            }
        };
        for attached in [false, true] {
            let Some(ring) = &self.ring else { return };
            if self.machine.end().is_some() {
                return;
            }
            let settled = |key, fate| outbox.settle(key, fate);
            let sent = self.machine.ring_send(ring, &message, settled);
            match sent {
                Ok(bell) => {
                    outbox.hold(key);
                    if bell {
                        self.ring_the_bell();
                    }
                    self.note_ring_sent(key, outbox, tools);
                    return;
                }
                Err(link::Error::Ended(_)) => {
                    outbox.hold(key);
                    return self.drain_idle(tools.epoll, outbox);
                }
                Err(link::Error::Misuse(Misuse::NotAttached)) if !attached => {
                    self.feed(Input::Attach(message.segment), tools.epoll, outbox);
                }
                Err(link::Error::Misuse(misuse)) => {
                    debug_assert!(
                        matches!(
                            misuse,
                            Misuse::NoRoom | Misuse::NotAttached | Misuse::SegmentBusy
                        ),
                        "{misuse} on {}",
                        self.id
                    );
                    return self.ring_pass_over(tools);
                }
            }
        }
    }

    fn ring_pass_over(&mut self, tools: &mut Tools<'_>) {
        let _ = self.machine.ring_pass_over();
        self.note_fates(tools.counting);
    }

    fn note_ring_sent(&mut self, key: u64, outbox: &Outbox, tools: &mut Tools<'_>) {
        if let Some(label) = outbox.label(key) {
            self.note_sent(label.time, label.len, tools.counting);
        }
    }

    /// Takes back what the receiver gave back.
    pub(super) fn ring_harvest(&mut self, tools: &mut Tools<'_>, outbox: &mut Outbox) {
        if self.has_call_rings() {
            return self.harvest_calls(tools, outbox);
        }
        let Some(ring) = &self.ring else { return };
        if !self.role().sends() || self.machine.end().is_some() {
            return;
        }
        let settled = |key: u64, fate: Fate| outbox.settle(key, fate);
        if self.machine.ring_harvest(ring, settled).is_err() {
            self.drain_idle(tools.epoll, outbox);
        }
        self.note_fates(tools.counting);
    }

    /// Whether one more message would neither displace another nor be refused.
    pub(super) fn ring_has_room(&self) -> bool {
        let ring = self.ring.as_ref();
        ring.is_some_and(|ring| self.machine.ring_has_room(ring))
    }

    /// Whether there may be a message to take.
    pub(super) fn ring_ready(&self) -> bool {
        let ring = self.ring.as_ref();
        ring.is_some_and(|ring| self.machine.ring_ready(ring))
    }

    /// How many messages the application has not taken.
    pub(super) fn ring_waiting(&self) -> usize {
        let ring = self.ring.as_ref();
        ring.map_or(0, |ring| self.machine.ring_waiting(ring))
    }

    /// The next message for the application.
    #[inline]
    pub(super) fn ring_take(
        &mut self,
        tools: &mut Tools<'_>,
        outbox: &mut Outbox,
    ) -> Result<Option<Delivery>, TooManyBorrowed> {
        for looked in [false, true] {
            let Some(ring) = &self.ring else {
                return Ok(None);
            };
            let segments = &self.segments;
            let head = |segment: u32, offset: u64, stride: u64| {
                (segments.get(&segment)?).copy::<SLOT_HEAD>(offset + stride - SLOT_HEAD as u64)
            };
            self.prefetch_next(ring);
            match self.machine.ring_take(ring, head) {
                Ok(taken) => {
                    if taken.is_some() {
                        self.ring_taken(ring);
                    }
                    if self.has_call_rings() {
                        // That a call is cancelled, or failed.
                        self.drain_idle(tools.epoll, outbox);
                    }
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
                Err(NoDelivery::UnknownSegment) => self.machine.ring_unknown_segment(),
                Err(NoDelivery::Ended(_) | NoDelivery::Misuse(_)) => break,
            }
        }
        self.drain_idle(tools.epoll, outbox);
        Ok(None)
    }

    /// No read goes ahead of the atomic operation that takes a word. So what is read after it, from lines
    /// that the sender's core has, is fetched while that goes on.
    #[inline]
    fn prefetch_next(&self, ring: &Ring) {
        if let Some((segment, offset, stride)) = self.machine.ring_peek(ring)
            && let Some(mapping) = self.segments.get(&segment)
        {
            mapping.prefetch(offset + stride - SLOT_HEAD as u64);
            mapping.prefetch(offset);
        }
    }

    /// A message was taken out of the ring.
    fn ring_taken(&self, ring: &Ring) {
        // The parked word stays as it is: another thread of this subscriber may sleep.
        if self.machine.ring_made_room(ring) {
            self.ring_the_bell();
        }
    }

    /// The application gives a message back.
    //= SM2-RNG-008
    pub(super) fn ring_release(&mut self, sequence: u64, epoll: &Epoll, outbox: &mut Outbox) {
        let Some(ring) = &self.ring else { return };
        match self.machine.ring_release(ring, sequence) {
            Ok(true) => self.ring_the_bell(),
            Ok(false) => {}
            Err(_) => self.drain_idle(epoll, outbox),
        }
    }

    /// Somebody is about to sleep until something happens on this link.
    //= SM2-RNG-009
    pub(super) fn park(&self) {
        if let Some(ring) = &self.ring
            && self.machine.end().is_none()
        {
            self.machine.ring_park(ring);
        }
    }

    /// A socket that takes no more has something to read: its other end is awake, or will be.
    //= SM2-RNG-009
    pub(super) fn ring_the_bell(&self) {
        if let Some(socket) = &self.socket {
            let _ = socket.send(&[IoSlice::new(&doorbell())], &[]);
        }
    }
}
