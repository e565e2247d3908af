//! One link on the road of a short message: see `interface/road.rs`.

use sm2_proto::Instant;
use sm2_proto::link::{CellMessage, Error, Fate, LaneKind, RingMessage, Status, Wake};

use super::LinkDriver;
use super::wire::Wire;
use crate::driver::context::Context;
use crate::driver::outbox::{MessageKey, Outbox};

impl LinkDriver {
    /// Whether the link takes a message of this length now, through its ring.
    #[inline]
    pub(in crate::driver) fn is_on_road(&self, len: u64) -> bool {
        self.is_open()
            && self.machine.lane() == LaneKind::Ring
            && self.accepts(len)
            && self.suspended.is_none()
            && self.backlog.keys.is_empty()
            && (!self.is_reliable() || self.has_room())
    }

    /// Whether an open link with a ring does not take a message now, and does not delay its publication.
    pub(in crate::driver) fn is_beside_road(&self) -> bool {
        self.is_open() && self.machine.lane() == LaneKind::Ring && !self.delays_publication()
    }

    /// Sends a message that the outbox holds.
    #[inline]
    pub(in crate::driver) fn send_on_road(
        &mut self,
        message: &RingMessage,
        time: Instant,
        context: &mut Context<'_>,
        outbox: &mut Outbox,
    ) {
        let key = MessageKey::from_raw(message.key);
        // The call itself may settle the message, so the link holds it before the call.
        outbox.hold(key);
        let settled = |key, fate| outbox.settle(MessageKey::from_raw(key), fate);
        match self.machine.send_in_slot(&self.mapped, message, settled) {
            Ok(wake) => self.sent_on_road(wake, (time, message.len), context, outbox),
            Err(error) => self.not_sent_on_road(&error, key, context, outbox),
        }
    }

    /// Whether the link takes short messages in cells of its ring now.
    #[inline]
    pub(in crate::driver) fn takes_cells(&self) -> bool {
        self.machine.takes_cells(&self.mapped)
    }

    /// Sends a message in a cell of the link, which [takes](Self::takes_cells) cells and is [on the
    /// road](Self::is_on_road).
    #[inline]
    pub(in crate::driver) fn send_in_cell(
        &mut self,
        message: &CellMessage<'_>,
        context: &mut Context<'_>,
        outbox: &mut Outbox,
    ) {
        let settled = |key, fate| outbox.settle(MessageKey::from_raw(key), fate);
        match self.machine.send_in_cell(&self.mapped, message, settled) {
            Ok(wake) => {
                let len = message.bytes.len() as u64;
                self.sent_on_road(wake, (message.time, len), context, outbox);
            }
            // The outputs tell.
            Err(Error::Ended(_)) => self.drain_idle(context.sets, outbox),
            Err(Error::Misuse(misuse)) => {
                debug_assert!(false, "the link takes cells: {misuse}");
                self.drop_publication(Fate::NoRoom, context, outbox);
            }
        }
    }

    /// Does the work that follows from a message of this time and length that is in the ring.
    #[inline]
    fn sent_on_road(
        &mut self,
        wake: Wake,
        (time, len): (Instant, u64),
        context: &mut Context<'_>,
        outbox: &mut Outbox,
    ) {
        self.wake(wake, context.sets);
        self.drain_if_due(context.sets, outbox);
        self.count_sent(time, len, context.now);
        if self.wire.as_ref().is_some_and(Wire::wakes_background) {
            self.watch_in_background(context.sets);
        }
    }

    #[cold]
    fn not_sent_on_road(
        &mut self,
        error: &Error,
        key: MessageKey,
        context: &mut Context<'_>,
        outbox: &mut Outbox,
    ) {
        match error {
            // The outputs settle the message with all others.
            Error::Ended(_) => self.drain_idle(context.sets, outbox),
            // Its segment is not attached yet, or the socket does not accept ATTACH.
            Error::Misuse(_) => {
                outbox.release(key);
                self.send(key, Status::Ok, context, outbox);
                self.watch_in_background(context.sets);
            }
        }
    }
}
