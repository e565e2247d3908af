//! Messages that are older than their lifespan.

use sm2_proto::link::{Delivery, Input};
use sm2_proto::{Instant, Period};

use super::LinkDriver;
use crate::driver::context::Context;
use crate::driver::counters::note;
use crate::driver::outbox::Outbox;

impl LinkDriver {
    /// Gives a message back that is older than its lifespan. The next message reports what was lost before this one.
    //= SM2-QOS-010
    #[cold]
    pub(super) fn drop_taken(
        &mut self,
        delivery: &Delivery,
        context: &mut Context<'_>,
        outbox: &mut Outbox,
    ) {
        self.account.expire(delivery, self.entry.as_mut());
        self.lost_with_expired = self.lost_with_expired.saturating_add(delivery.lost);
        self.received.expired += 1;
        note(self.entry.as_mut(), |entry| entry.expired(1));
        self.kept.remove(&delivery.sequence);
        let wake = self.machine.expire(&self.mapped, delivery);
        self.wake(wake.unwrap_or_default(), context.sets);
        self.drain_if_due(context.sets, outbox);
    }

    /// Whether a message of the backlog with this time is older than its lifespan.
    pub(in crate::driver) fn is_expired(&self, time: Instant) -> bool {
        self.machine.is_expired(time, sm2_io::clock::now)
    }

    /// Counts a message that is older than its lifespan as not sent on this link.
    //= SM2-QOS-010
    pub(in crate::driver) fn drop_expired(
        &mut self,
        context: &mut Context<'_>,
        outbox: &mut Outbox,
    ) {
        self.feed(Input::Expired, context.sets, outbox);
        self.note_fates();
    }

    /// Drops the messages that wait for the window and are older than their lifespan.
    //= SM2-QOS-010
    #[inline]
    pub(super) fn expire_unsent(&mut self, context: &Context<'_>, outbox: &mut Outbox) {
        if self.machine.config().lifespan != Period::NONE && self.machine.has_queued() {
            self.machine.expire_unsent(sm2_io::clock::now());
            self.drain_idle(context.sets, outbox);
        }
    }
}
