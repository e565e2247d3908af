//! Sending the messages of a link, on whichever lane its machine has agreed on.

use sm2_proto::Farewell;
use sm2_proto::link::{Body, Error, Fate, Input, Misuse, Role, Status, Wake};

use super::LinkDriver;
use crate::driver::context::Context;
use crate::driver::outbox::{MessageKey, NoForm, Outbox};

impl LinkDriver {
    /// Sends a message that the outbox holds. If there is no slot or no room for a publication at
    /// this moment, the publication is not sent on this link, or waits in the backlog. If memory for
    /// a message is missing for another reason, the link ends, because it would miss a message that
    /// other links get.
    pub(in crate::driver) fn send(
        &mut self,
        key: MessageKey,
        status: Status,
        context: &mut Context<'_>,
        outbox: &mut Outbox,
    ) {
        if !self.backlog.keys.is_empty() && !self.is_reliable() {
            self.displace_oldest_of_backlog(key, context, outbox);
        } else if let Err(misuse) = self.try_send(key, status, context, outbox) {
            self.without_room(key, misuse, context, outbox);
        }
    }

    /// Lets a message wait behind those of the backlog, which have smaller ids, and in place of the oldest of them.
    //= SM2-QOS-001, SM2-MSG-002
    #[cold]
    fn displace_oldest_of_backlog(
        &mut self,
        key: MessageKey,
        context: &mut Context<'_>,
        outbox: &mut Outbox,
    ) {
        outbox.hold(key);
        self.backlog.keys.push_back(key);
        if let Some(oldest) = self.backlog.keys.pop_front() {
            self.drop_publication(Fate::Overwritten, context, outbox);
            outbox.release(oldest);
        }
    }

    /// The same as [`send`](Self::send) for a message of the backlog, which stays there as long as the
    /// socket does not accept the ATTACH of its segment.
    pub(in crate::driver) fn send_from_backlog(
        &mut self,
        key: MessageKey,
        context: &mut Context<'_>,
        outbox: &mut Outbox,
    ) {
        if let Err(misuse) = self.try_send(key, Status::Ok, context, outbox) {
            self.without_room(key, misuse, context, outbox);
        }
    }

    /// Sends a message, or does what a missing form asks for. An error says that the message was not sent
    /// and not counted.
    fn try_send(
        &mut self,
        key: MessageKey,
        status: Status,
        context: &mut Context<'_>,
        outbox: &mut Outbox,
    ) -> Result<(), Misuse> {
        let mut is_last = false;
        loop {
            if self.machine.end().is_some() {
                break;
            }
            let message = match outbox.message(key, status, self.machine.placement()) {
                Ok(message) => message,
                Err(error) => {
                    self.without_form(&error, context, outbox);
                    break;
                }
            };
            let segment = match &message.body {
                Body::Pooled { segment, .. } => Some(*segment),
                Body::Inline(_) | Body::Sealed => None,
            };
            let (time, len) = (message.time, message.len);
            // The call itself may settle the message, so the link holds it before the call.
            outbox.hold(key);
            let settled = |key, fate| outbox.settle(MessageKey::from_raw(key), fate);
            let misuse = match self.machine.send(&self.mapped, message, settled) {
                Ok(wake) => {
                    self.finish_sending(wake, context, outbox);
                    self.count_sent(time, len, context.now);
                    break;
                }
                // The outputs settle the message with all others.
                Err(Error::Ended(_)) => {
                    self.drain_idle(context.sets, outbox);
                    break;
                }
                Err(Error::Misuse(misuse)) => misuse,
            };
            outbox.release(key);
            match (misuse, segment) {
                (Misuse::NotAttached, Some(segment)) if !is_last => {
                    self.feed(Input::Attach(segment), context.sets, outbox);
                    is_last = true;
                }
                _ => return Err(misuse),
            }
        }
        Ok(())
    }

    /// Completes the sending of a message that the machine has accepted.
    fn finish_sending(&mut self, wake: Wake, context: &mut Context<'_>, outbox: &mut Outbox) {
        self.wake(wake, context.sets);
        self.drain_if_due(context.sets, outbox);
        if self.machine.is_due() {
            self.harvest(context, outbox);
        }
    }

    /// Handles a message that cannot be put into the form that this link needs.
    fn without_form(&mut self, error: &NoForm, context: &mut Context<'_>, outbox: &mut Outbox) {
        let peer = &self.origin.peer.name;
        if matches!(error, NoForm::Slot(_)) && self.role() == Role::Sender {
            tracing::warn!(link = %self.id, %peer, %error, "no slot for a message: this link misses it");
            return self.drop_publication(Fate::Overwritten, context, outbox);
        }
        tracing::warn!(link = %self.id, %peer, %error, "no memory for a message: this link is closed");
        let code = Farewell::Resources.code();
        self.feed(Input::Close(code), context.sets, outbox);
    }

    /// Handles a message without room: it waits in the backlog until the socket has accepted the ATTACH of its
    /// segment, or the publication is not sent on this link.
    fn without_room(
        &mut self,
        key: MessageKey,
        misuse: Misuse,
        context: &mut Context<'_>,
        outbox: &mut Outbox,
    ) {
        debug_assert!(
            matches!(
                misuse,
                Misuse::NoRoom | Misuse::NotAttached | Misuse::SegmentBusy
            ),
            "{misuse} on {}",
            self.id
        );
        if self.role() != Role::Sender {
            return;
        }
        //= SM2-QOS-001, SM2-QOS-002, SM2-QOS-005
        if misuse == Misuse::NoRoom && self.has_unsent() {
            outbox.hold(key);
            return self.backlog.keys.push_front(key);
        }
        self.drop_publication(Fate::Overwritten, context, outbox);
    }

    /// Drops a publication for this link alone.
    //= SM2-QOS-010, SM2-QOS-007
    pub(in crate::driver) fn drop_publication(
        &mut self,
        fate: Fate,
        context: &mut Context<'_>,
        outbox: &mut Outbox,
    ) {
        self.feed(Input::Drop(fate), context.sets, outbox);
        self.write_fates();
    }

    /// Drops a message for this link alone, because the other side does not accept messages of this
    /// length.
    //= SM2-QOS-008
    pub(in crate::driver) fn drop_too_long(
        &mut self,
        len: u64,
        context: &mut Context<'_>,
        outbox: &mut Outbox,
    ) {
        if self.counters().too_long == 0 {
            let (link, peer, max_len) = (self.id, &self.origin.peer.name, self.peer_max_len());
            tracing::warn!(%link, %peer, len, max_len, "the peer misses a message that is longer than it accepts");
        }
        self.drop_publication(Fate::TooLong, context, outbox);
    }

    /// Drops a message for this link alone, because it had no room until the deadline, or
    /// because the publisher does not wait for it.
    //= SM2-QOS-002, SM2-QOS-003
    pub(in crate::driver) fn drop_without_room(
        &mut self,
        context: &mut Context<'_>,
        outbox: &mut Outbox,
    ) {
        if self.is_suspended() && self.is_open() {
            return self.drop_publication(Fate::PoolLimit, context, outbox);
        }
        debug_assert!(
            !self.has_room_for_backlog(),
            "what is latched fills all room"
        );
        if !self.has_room_for_backlog() && self.is_open() {
            if self.counters().no_room == 0 {
                let (link, peer) = (self.id, &self.origin.peer.name);
                tracing::warn!(%link, %peer, "a reliable subscriber without room misses messages until it catches up");
            }
            self.drop_publication(Fate::NoRoom, context, outbox);
        }
    }

    /// Settles the messages that the receiver gave back, and sends queued messages into the new
    /// room.
    pub(in crate::driver) fn harvest(&mut self, context: &mut Context<'_>, outbox: &mut Outbox) {
        self.expire_unsent(context, outbox);
        while self.machine.end().is_none() {
            let settled = |key, fate| outbox.settle(MessageKey::from_raw(key), fate);
            let harvested = self.machine.harvest(&self.mapped, settled);
            self.wake(harvested.unwrap_or_default(), context.sets);
            self.drain_if_due(context.sets, outbox);
            if !self.machine.is_due() {
                break;
            }
        }
        // `settled` is not called for messages in cells.
        self.write_fates();
    }

    /// Settles the messages that came back before the link may end, and sends nothing.
    //= SM2-RNG-010
    pub(super) fn settle_returned(&mut self, context: &mut Context<'_>, outbox: &mut Outbox) {
        if self.machine.is_woken_by_socket() || self.machine.end().is_some() {
            return;
        }
        let settled = |key, fate| outbox.settle(MessageKey::from_raw(key), fate);
        // If the call finds a violation, the outputs report it.
        let _ = self.machine.settle_returned(&self.mapped, settled);
        self.drain_if_due(context.sets, outbox);
        self.write_fates();
    }

    /// Sends queued messages after a change that may let them through: a freed segment number, a
    /// writable socket, or room.
    pub(in crate::driver) fn send_queued(
        &mut self,
        context: &mut Context<'_>,
        outbox: &mut Outbox,
    ) {
        if self.machine.has_queued() {
            self.harvest(context, outbox);
        }
    }

    /// Whether the link was suspended and has released nothing since.
    #[inline]
    pub(in crate::driver) fn is_suspended(&self) -> bool {
        self.suspended
            .is_some_and(|released| released == self.released())
    }

    /// Whether the link was suspended, and its receiver has released something since.
    #[inline]
    pub(in crate::driver) fn is_resuming(&self) -> bool {
        self.suspended.is_some() && !self.is_suspended()
    }

    pub(in crate::driver) fn suspend(&mut self) {
        tracing::debug!(link = %self.id, peer = %self.origin.peer.name, "suspended at the pool limit");
        self.suspended = Some(self.released());
    }

    /// Makes the link active again if its receiver has released something.
    pub(in crate::driver) fn resume_if_released(&mut self) {
        if self.is_resuming() {
            self.suspended = None;
        }
    }

    /// How many messages were released. A message that has expired gives its memory back as well.
    //= SM2-QOS-010
    fn released(&self) -> u64 {
        let counters = self.counters();
        counters.delivered + counters.discarded + counters.expired
    }

    /// Passes the key of each message in flight to `each`.
    pub(in crate::driver) fn in_flight_keys(&self, each: impl FnMut(u64)) {
        self.machine.in_flight_keys(each);
    }
}
