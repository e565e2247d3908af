//! The work that follows from a change of a link, or from a tick: settled messages, replies, segments without
//! messages, and the end of links.

use sm2_proto::Contract;
use sm2_proto::link::Input;

use super::DeclaredInterface;
use crate::driver::context::Context;
use crate::driver::link::LinkDriver;
use crate::driver::token::LinkToken;

impl DeclaredInterface {
    /// Settles the messages that the other sides have released on the ring lane.
    #[inline]
    pub(crate) fn harvest(&mut self, context: &mut Context<'_>) {
        if !matches!(self.contract, Contract::Subscriber { .. }) {
            self.harvest_links(context);
        }
    }

    fn harvest_links(&mut self, context: &mut Context<'_>) {
        let mut is_over = false;
        for link in self.links.iter_mut() {
            link.harvest(context, &mut self.outbox);
            is_over |= link.is_over_unnoticed();
        }
        // A fault in its ring has ended the link, so the Manager has to be told.
        if is_over {
            self.notice_ends(context);
        }
        // The last message of a segment may have come back.
        self.detach_segments(context);
    }

    /// Does the work that follows from a change of a link: replays latched messages, hands out
    /// replies, retires segments, and removes the link if it has ended. Every caller that feeds a
    /// link calls this function.
    pub(super) fn settle_link(&mut self, token: LinkToken, context: &mut Context<'_>) {
        let Some(link) = self.links.get_mut(token) else {
            return;
        };
        self.latched.replay(link, context, &mut self.outbox);
        self.calls.collect(token, link, context, &mut self.outbox);
        link.send_queued(context, &mut self.outbox);
        link.watch_in_background(context.sets);
        link.write_fates();
        self.reports.report_state(link);
        let is_over = link.is_over_unnoticed();
        (self.absence).count(token, &mut self.links, &mut self.reports);
        if is_over {
            self.notice_end(token);
        }
        if let Some(link) = self.links.get_mut(token) {
            let change = link.take_liveliness_change();
            (self.reports).report_liveliness(change, Some(&link.origin.peer));
        }
        self.ask_for_tick();
        self.detach_segments(context);
        let Some(link) = self.links.get(token).filter(|it| it.end_noticed) else {
            return;
        };
        if link.is_denied() {
            let untaken = link.untaken() as u64;
            self.remove(token, untaken);
        } else if !link.may_take() {
            self.remove(token, 0);
        }
    }

    /// The access policy denies the interface: discards what links that have ended left. The Manager
    /// ends the other links.
    //= SM2-ACC-014
    pub(in crate::driver) fn discard_ended(&mut self, context: &mut Context<'_>) {
        for token in self.links.tokens_of(|link| link.end_noticed) {
            self.with_link(token, context, |link, _, _| link.deny());
        }
    }

    /// Counts the periods that have passed without a message, checks who is alive, and asks for the next tick.
    //= SM2-QOS-009, SM2-QOS-011
    pub(in crate::driver) fn tick(&mut self, context: &mut Context<'_>) {
        self.qos.tick(context.now, &mut self.reports);
        for token in self.links.tokens_of(|_| true) {
            self.with_link(token, context, |link, outbox, context| {
                link.tick(context, outbox);
            });
            if let Some(link) = self.links.get_mut(token) {
                let missed = link.take_missed();
                (self.reports).count_missed(missed, Some(&link.origin.peer));
            }
        }
        self.ask_for_tick();
    }

    /// Asks the control side for a tick at the end of the next period, if it does not know of one before.
    #[inline]
    pub(in crate::driver) fn ask_for_tick(&mut self) {
        if let Some(at) = self.qos.next_tick(&self.links) {
            self.for_control.tick_at = Some(at);
        }
    }

    /// Settles the links that ended during a send.
    pub(super) fn notice_ends(&mut self, context: &mut Context<'_>) {
        for token in self.links.tokens_of(LinkDriver::is_over_unnoticed) {
            self.settle_link(token, context);
        }
        self.detach_segments(context);
    }

    /// Records the end of a link: queues it for the Manager, keeps its counters, and drops the messages of the oldest
    /// links that are over.
    fn notice_end(&mut self, token: LinkToken) {
        let Some(link) = self.links.notice_end(token) else {
            return;
        };
        self.outbox.recheck();
        self.for_control.freed.extend(link.counting.entry.take());
        for key in link.backlog.keys.drain(..) {
            self.outbox.release(key);
        }
        if let Some(code) = link.end_code() {
            self.for_control.ends.push((link.id, code));
        }
        // An application that takes no messages must not collect those of all past publishers.
        for token in self.links.surplus() {
            let untaken = self.links.get(token).map_or(0, LinkDriver::untaken);
            self.remove(token, untaken as u64);
        }
    }

    /// Removes a link that no message is taken from any more. `dropped` messages of it are lost.
    fn remove(&mut self, token: LinkToken, dropped: u64) {
        // An account of a link that waited for an older one until now.
        (self.absence).count(token, &mut self.links, &mut self.reports);
        if let Some(link) = self.links.remove(token) {
            self.for_control.gone.push(token);
            (self.absence).close_account(&link, dropped, &mut self.links, &mut self.reports);
        }
    }

    /// Tells all links which segments are not used any more.
    #[inline]
    pub(crate) fn detach_segments(&mut self, context: &mut Context<'_>) {
        while let Some(segment) = self.outbox.over.pop() {
            for link in self.links.iter_mut().filter(|link| link.end().is_none()) {
                link.feed(Input::Retire { segment }, context.sets, &mut self.outbox);
            }
        }
    }
}
