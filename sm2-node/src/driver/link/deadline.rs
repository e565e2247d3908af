//! The ticks of a link: the deadline of a subscriber, and the liveliness of a publisher.

use std::mem;

use sm2_proto::{Instant, Machine};

use super::LinkDriver;
use crate::driver::context::Context;
use crate::driver::counters::note;
use crate::driver::outbox::Outbox;

impl LinkDriver {
    /// The time of the next tick, if there is one.
    pub(in crate::driver) fn deadline(&self) -> Option<Instant> {
        self.machine.deadline()
    }

    /// Subscriber: counts the periods that have passed without a message, and checks whether the publisher is alive.
    /// On the socket lane the messages may wait in the socket; ALIVE does so on both lanes. Publisher: sends ALIVE that
    /// was held back.
    //= SM2-QOS-009, SM2-QOS-012, SM2-QOS-013
    pub(in crate::driver) fn tick(&mut self, context: &mut Context<'_>, outbox: &mut Outbox) {
        if self.deadline().is_none_or(|due| context.now < due) {
            return;
        }
        self.receive_all(context, outbox);
        self.machine.tick(context.now, &self.mapped);
        self.drain_idle(context.sets, outbox);
    }

    /// How many periods have passed without a message.
    pub(in crate::driver) fn missed_deadlines(&self) -> u64 {
        self.machine.missed_deadlines()
    }

    /// How many more periods have passed without a message than at the last call.
    pub(in crate::driver) fn take_new_misses(&mut self) -> u64 {
        let missed = self.missed_deadlines();
        let more = missed - mem::replace(&mut self.reported_misses, missed);
        if more > 0 {
            note(self.entry.as_mut(), |entry| entry.missed_deadlines(more));
        }
        more
    }
}
