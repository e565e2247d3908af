//! Calls on the ring lane: requests and replies go past the sockets, in two rings.
//!
//! The ring of a link's field `ring` is the one that this side takes messages from, here as on
//! topics; the one it sends by is `ring_out`. What there is no room for waits in the machine.

use sm2_io::Epoll;
use sm2_proto::Farewell;
use sm2_proto::link::{Error, Fate, Input, Role, Status};

use super::super::Inner;
use super::super::link::{LinkDriver, Tools};
use super::super::outbox::Outbox;
use crate::handle::Handle;

impl LinkDriver {
    /// Whether calls go through its rings.
    pub(in crate::driver) fn has_call_rings(&self) -> bool {
        self.has_ring() && matches!(self.role(), Role::Caller | Role::Server)
    }

    /// Sends a request or a reply that the outbox holds. If it cannot be put into a slot, the
    /// link ends: whoever is at its other end waits for it.
    pub(in crate::driver) fn ring_send_call(
        &mut self,
        key: u64,
        status: Status,
        tools: &mut Tools<'_>,
        outbox: &mut Outbox,
    ) {
        let message = match outbox.ring_call(key, status) {
            Ok(message) => message,
            Err(error) => {
                tracing::warn!(link = %self.id, peer = %self.peer.name, %error, "no slot for a call");
                let code = Farewell::Resources.code();
                return self.feed(Input::Close(code), tools.epoll, outbox);
            }
        };
        let Some(ring) = self.ring_out.as_ref().filter(|_| self.end().is_none()) else {
            return;
        };
        outbox.hold(key);
        let settled = |key: u64, fate: Fate| outbox.settle(key, fate);
        let sent = self.machine.ring_send(ring, &message, settled);
        if let Err(Error::Misuse(misuse)) = sent {
            debug_assert!(false, "{misuse} on {}", self.id);
            return outbox.release(key);
        }
        self.put_into_ring(sent, tools.epoll, outbox);
        if self.machine.ring_is_due() {
            self.harvest_calls(tools, outbox);
        }
        if let Some(label) = outbox.label(key) {
            self.note_sent(label.time, label.len, tools.counting);
        }
    }

    /// Takes back what the other side gave back, and sends what waited for that.
    pub(in crate::driver) fn harvest_calls(&mut self, tools: &mut Tools<'_>, outbox: &mut Outbox) {
        while let Some(ring) = self.ring_out.as_ref().filter(|_| self.end().is_none()) {
            let settled = |key: u64, fate: Fate| outbox.settle(key, fate);
            let harvested = self.machine.ring_harvest(ring, settled);
            self.put_into_ring(harvested, tools.epoll, outbox);
            if !self.machine.ring_is_due() {
                break;
            }
        }
        self.note_fates(tools.counting);
    }

    /// Sends what waited for what has just changed: a segment's number, the socket, room.
    pub(in crate::driver) fn send_waiting(&mut self, tools: &mut Tools<'_>, outbox: &mut Outbox) {
        if self.machine.ring_is_waiting() {
            self.harvest_calls(tools, outbox);
        }
    }

    /// Does what follows from words that were put.
    fn put_into_ring(&mut self, bell: Result<bool, Error>, epoll: &Epoll, outbox: &mut Outbox) {
        if bell == Ok(true) {
            self.ring_the_bell();
        }
        // A segment to attach, or the end.
        if bell.is_err() || self.machine.ring_is_waiting() {
            self.drain_idle(epoll, outbox);
        }
    }
}

impl Inner {
    /// Looks at the sockets before a reply; on the ring lane only if that was not done for a while.
    pub(crate) fn drive_for_reply(&mut self, handle: &Handle, token: u64) {
        let link = self
            .interfaces
            .get(&handle.id)
            .and_then(|it| it.link(token));
        let is_call_free = link.is_some_and(LinkDriver::has_ring);
        let epoll = &handle.shared.epoll;
        if !self.drive_if_due(sm2_io::clock::now(), epoll) && !is_call_free {
            self.drive(epoll);
        }
    }
}
