//! Counting the missed deadlines of a publisher, and those of the links of a subscriber, and checking who is alive.

use std::mem;
use std::sync::Arc;

use sm2_proto::{DeadlineWatch, Instant, LeaseWatch, Period};

use super::Interface;
use crate::Event;
use crate::driver::context::Context;
use crate::driver::counters::note;
use crate::driver::link::LinkDriver;

impl Interface {
    /// The publisher publishes a message at this time.
    //= SM2-QOS-009
    #[inline]
    pub(super) fn meet_deadline(&mut self, time: Instant) {
        if let Some(watch) = &mut self.deadline.watch {
            watch.published(time);
        }
    }

    /// Counts the periods that have passed without a message, checks who is alive, and asks for the next tick.
    //= SM2-QOS-009, SM2-QOS-012
    pub(in crate::driver) fn tick(&mut self, context: &mut Context<'_>) {
        self.deadline.tick_at = None;
        if let Some(watch) = &mut self.deadline.watch {
            watch.count_missed(context.now);
            let missed = watch.missed();
            let more = missed - mem::replace(&mut self.deadline.reported, missed);
            if more > 0 {
                note(self.entry.as_mut(), |entry| entry.missed_deadlines(more));
                self.events.push(Event::DeadlineMissed {
                    peer: None,
                    periods: more,
                });
            }
        }
        self.check_liveliness(context.now);
        let tokens: Vec<_> = self.tokens().collect();
        for token in tokens {
            self.with_link(token, context, |link, outbox, context| {
                link.tick(context, outbox);
            });
            let Some(link) = self.links.get_mut(token) else {
                continue;
            };
            let more = link.take_new_misses();
            if more > 0 {
                note(self.entry.as_mut(), |entry| entry.missed_deadlines(more));
                self.events.push(Event::DeadlineMissed {
                    peer: Some(Arc::clone(&link.peer)),
                    periods: more,
                });
            }
        }
        self.ask_for_tick();
    }

    /// Asks the control side for a tick at the end of the next period, if it does not know of one before.
    #[inline]
    pub(in crate::driver) fn ask_for_tick(&mut self) {
        if self.contract.deadline() == Period::NONE && self.contract.lease() == Period::NONE {
            return;
        }
        let deadline = self.deadline.watch.as_ref().map(DeadlineWatch::due);
        let lease = self.lease.watch.as_ref().map(LeaseWatch::due);
        let due = self.links.iter().filter_map(LinkDriver::deadline);
        let Some(due) = due.chain(deadline).chain(lease).min() else {
            return;
        };
        if self.deadline.tick_at.is_none_or(|known| due < known) {
            self.deadline.tick_at = Some(due);
            self.for_control.tick_at = Some(due);
        }
    }

    /// Keeps the count of a link that is about to be removed.
    pub(super) fn keep_missed_deadlines(&mut self, missed: u64) {
        self.deadline.missed_on_ended_links += missed;
    }

    /// How many periods of the deadline have passed without a message: a publisher counts its own, a subscriber those
    /// of all its links, current and past.
    pub(crate) fn missed_deadlines(&self) -> u64 {
        let own = (self.deadline.watch.as_ref()).map_or(0, DeadlineWatch::missed);
        let links = self.links().filter(|link| !link.buried);
        own + self.deadline.missed_on_ended_links
            + links.map(LinkDriver::missed_deadlines).sum::<u64>()
    }
}
