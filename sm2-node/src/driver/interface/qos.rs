//! The deadline and the lease of an interface: of its publisher, and of the publishers at the other ends of its links.

use std::mem;
use std::sync::Arc;

use sm2_proto::control::LinkPeer;
use sm2_proto::link::Input;
use sm2_proto::{DeadlineWatch, Instant, LeaseWatch, Newest, Period};

use super::Interface;
use crate::Event;
use crate::driver::context::Context;
use crate::driver::counters::note;
use crate::driver::link::LinkDriver;
use crate::driver::token::LinkToken;

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

    /// The publisher publishes at this time, which asserts its liveliness. If it was not alive, its subscribers learn
    /// of it at once.
    //= SM2-QOS-012, SM2-QOS-013
    #[inline]
    pub(super) fn assert_by_publication(&mut self, time: Instant, context: &mut Context<'_>) {
        if let Some(watch) = &mut self.lease.watch {
            let was_alive = watch.is_alive();
            watch.assert(time, time);
            if !was_alive {
                self.assert_liveliness(time, context);
            }
            // ALIVE may have been held back on a link that does not get the message.
            self.ask_for_tick();
        }
    }

    /// The program asserts the liveliness of its publisher at this time.
    //= SM2-QOS-012, SM2-QOS-013
    pub(crate) fn assert_liveliness(&mut self, time: Instant, context: &mut Context<'_>) {
        if let Some(watch) = &mut self.lease.watch {
            watch.assert(time, time);
        }
        self.note_own_liveliness();
        for link in self.links.iter_mut().filter(|link| link.is_open()) {
            link.feed(Input::Assert(time), context.sets, &mut self.outbox);
        }
        self.bury_ended(context);
        self.ask_for_tick();
    }

    /// Checks the liveliness of the publisher of this interface.
    pub(super) fn check_liveliness(&mut self, now: Instant) {
        if let Some(watch) = &mut self.lease.watch {
            watch.check(Newest::NONE, now);
        }
        self.note_own_liveliness();
    }

    fn note_own_liveliness(&mut self) {
        let change = self.lease.watch.as_mut().and_then(LeaseWatch::take_change);
        if let Some(is_alive) = change {
            self.note_liveliness(is_alive, None);
        }
    }

    /// Tells the program whether the publisher at the other end of a link has stopped being alive, or is alive again.
    #[inline]
    pub(super) fn note_liveliness_of(&mut self, token: LinkToken) {
        let Some(link) = self.links.get_mut(token) else {
            return;
        };
        if let Some(is_alive) = link.take_liveliness_change() {
            let peer = Some(Arc::clone(&link.peer));
            self.note_liveliness(is_alive, peer);
        }
    }

    fn note_liveliness(&mut self, is_alive: bool, peer: Option<Arc<LinkPeer>>) {
        if is_alive {
            return self.events.push(Event::LivelinessRegained { peer });
        }
        note(self.entry.as_mut(), |entry| entry.lost_liveliness());
        self.events.push(Event::LivelinessLost { peer });
    }

    /// Keeps the count of a link that is about to be removed.
    pub(super) fn keep_lost_liveliness(&mut self, losses: u64) {
        self.lease.lost_on_ended_links += losses;
    }

    /// How often a publisher stopped being alive: this one, or those of all links of a subscriber, current and past.
    pub(crate) fn lost_liveliness(&self) -> u64 {
        let own = (self.lease.watch.as_ref()).map_or(0, LeaseWatch::losses);
        let links = self.links().filter(|link| !link.buried);
        own + self.lease.lost_on_ended_links + links.map(LinkDriver::lost_liveliness).sum::<u64>()
    }
}
