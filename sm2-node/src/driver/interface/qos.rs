//! The deadline and the lease of an interface: of its publisher, and of the publishers at the other ends of its links.

use std::sync::Arc;

use sm2_proto::link::Input;
use sm2_proto::{Instant, Newest, Period};

use super::DeclaredInterface;
use crate::driver::context::Context;
use crate::driver::link::LinkDriver;
use crate::driver::token::LinkToken;

impl DeclaredInterface {
    /// The publisher publishes a message at this time, which asserts its liveliness. If it was not alive, its
    /// subscribers learn of it at once.
    //= SM2-QOS-009, SM2-QOS-011, SM2-QOS-012
    #[inline]
    pub(super) fn watch_publication(&mut self, time: Instant, context: &mut Context<'_>) {
        let was_alive = self.watch.is_alive();
        self.watch.published(time);
        if self.watch.has_lease() {
            if !was_alive {
                self.assert_liveliness(time, context);
            }
            // ALIVE may have been held back on a link that does not get the message.
            self.ask_for_tick();
        }
    }

    /// The program asserts the liveliness of its publisher at this time.
    //= SM2-QOS-011, SM2-QOS-012
    pub(crate) fn assert_liveliness(&mut self, time: Instant, context: &mut Context<'_>) {
        self.watch.assert(time, time);
        self.update_own_liveliness();
        for link in self.links.iter_mut().filter(|link| link.is_open()) {
            link.feed(Input::Assert(time), context.sets, &mut self.outbox);
        }
        self.notice_ends(context);
        self.ask_for_tick();
    }

    /// Counts the periods that have passed without a message, checks who is alive, and asks for the next tick.
    //= SM2-QOS-009, SM2-QOS-011
    pub(in crate::driver) fn tick(&mut self, context: &mut Context<'_>) {
        self.tick_at = None;
        self.watch.check(Newest::NONE, context.now);
        let missed = self.watch.take_missed();
        self.reports.count_missed(missed, None);
        self.update_own_liveliness();
        for token in self.links.tokens_of(|_| true) {
            self.with_link(token, context, |link, outbox, context| {
                link.tick(context, outbox);
            });
            if let Some(link) = self.links.get_mut(token) {
                let (missed, peer) = (link.take_missed(), Arc::clone(&link.origin.peer));
                self.reports.count_missed(missed, Some(peer));
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
        let due = self.links.iter().filter_map(LinkDriver::deadline);
        let Some(due) = due.chain(self.watch.due()).min() else {
            return;
        };
        if self.tick_at.is_none_or(|known| due < known) {
            self.tick_at = Some(due);
            self.for_control.tick_at = Some(due);
        }
    }

    fn update_own_liveliness(&mut self) {
        if let Some(is_alive) = self.watch.take_liveliness_change() {
            self.reports.report_liveliness(is_alive, None);
        }
    }

    /// Tells the program whether the publisher at the other end of a link has stopped being alive, or is alive again.
    #[inline]
    pub(super) fn update_liveliness_of(&mut self, token: LinkToken) {
        let Some(link) = self.links.get_mut(token) else {
            return;
        };
        if let Some(is_alive) = link.take_liveliness_change() {
            let peer = Some(Arc::clone(&link.origin.peer));
            self.reports.report_liveliness(is_alive, peer);
        }
    }

    /// How many periods of the deadline have passed without a message: a publisher counts its own, a subscriber those
    /// of all its links, current and past.
    pub(crate) fn missed_deadlines(&self) -> u64 {
        self.watch.missed_deadlines() + self.links.missed_deadlines()
    }

    /// How often a publisher stopped being alive: this one, or those of all links of a subscriber, current and past.
    pub(crate) fn lost_liveliness(&self) -> u64 {
        self.watch.lost_liveliness() + self.links.lost_liveliness()
    }
}
