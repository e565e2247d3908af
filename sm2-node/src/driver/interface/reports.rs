//! The reports of an interface: events and sums for its program, and counters for tools.

use std::sync::Arc;

use sm2_io::CounterEntry;
use sm2_proto::Instant;
use sm2_proto::control::LinkPeer;

use super::event_queue::EventQueue;
use super::links::Links;
use super::taken::Header;
use crate::Event;
use crate::driver::counters::{count_taken, update};
use crate::driver::link::LinkDriver;

/// The reports of an interface. Each loss is counted here at once in the entry, in the sums, and as an event, so that
/// these agree.
#[derive(Debug, Default)]
pub(crate) struct Reports {
    /// The entry of its counters, until the program drops the interface.
    pub(super) entry: Option<CounterEntry>,
    /// Events that the program has not taken.
    pub(crate) events: EventQueue,
    /// The number of messages that were published while no link was open.
    pub(crate) unheard: u64,
    /// How many publications the application misses, as far as the node knows.
    pub(crate) lost: u64,
    /// How many messages were published while their publisher had no link with this subscriber.
    pub(crate) away: u64,
}

impl Reports {
    /// Collects events from now on. The first ones are the links that are open.
    pub(crate) fn enable_events(&mut self, links: &mut Links) {
        if !self.events.enable() {
            return;
        }
        for link in links.iter_mut() {
            // Losses before now are not events.
            link.take_new_drops();
            if link.is_open() {
                self.report_joined(link);
            }
        }
    }

    /// Notes that a link has opened or ended, when that is noticed first, and what was lost on it.
    pub(super) fn report_state(&mut self, link: &mut LinkDriver) {
        if link.is_open() && !link.has_joined {
            self.report_joined(link);
        }
        if self.events.is_enabled() {
            self.report_drops_of(link);
        }
        if let Some(end) = link.end()
            && link.has_joined
        {
            link.has_joined = false;
            let peer = Arc::clone(&link.origin.peer);
            self.events.push(Event::Left { peer, end });
        }
    }

    fn report_joined(&mut self, link: &mut LinkDriver) {
        link.has_joined = true;
        let peer = Arc::clone(&link.origin.peer);
        self.events.push(Event::Joined { peer });
    }

    /// Notes the messages that subscribers do not get.
    #[inline]
    pub(super) fn report_drops(&mut self, links: &mut Links) {
        if self.events.is_enabled() {
            for link in links.iter_mut() {
                self.report_drops_of(link);
            }
        }
    }

    fn report_drops_of(&mut self, link: &mut LinkDriver) {
        let dropped = link.take_new_drops();
        self.events.push_loss(&link.origin.peer, dropped);
    }

    /// Counts a publication, and whether a link was open for it. A call of a client has one.
    #[inline]
    pub(super) fn count_publication(&mut self, time: Instant, len: u64, is_heard: bool) {
        self.unheard += u64::from(!is_heard);
        update(self.entry.as_mut(), |entry| {
            entry.published(time, len);
            if !is_heard {
                entry.unheard();
            }
        });
    }

    /// Counts a message that was taken at `now`, and the losses before it, `away` of them while its publisher had no
    /// link. A request counts as taken once it is neither cancelled nor late.
    #[inline]
    pub(super) fn count_taken(
        &mut self,
        peer: &Arc<LinkPeer>,
        header: &Header,
        away: u64,
        now: Instant,
        is_topic: bool,
    ) {
        self.lost = self.lost.saturating_add(header.lost);
        self.away = self.away.saturating_add(away);
        self.events.push_loss(peer, header.lost);
        if is_topic {
            count_taken(self.entry.as_mut(), now, header, |entry| {
                if away > 0 {
                    entry.away(away);
                }
            });
        }
    }

    /// Counts a request that the application took at this time. A request carries its deadline, not the time when
    /// it was sent.
    pub(super) fn count_request(&mut self, link: Option<&mut LinkDriver>, now: Instant, len: u64) {
        let of_link = link.and_then(|it| it.counting.entry.as_mut());
        for entry in [self.entry.as_mut(), of_link] {
            update(entry, |entry| entry.taken(now, now, len));
        }
    }

    /// Counts messages of this publisher that the application will not get, `away` of them published while it had no
    /// link.
    pub(super) fn lose(&mut self, publisher: &Arc<LinkPeer>, messages: u64, away: u64) {
        if messages == 0 {
            return;
        }
        self.lost = self.lost.saturating_add(messages);
        self.away = self.away.saturating_add(away);
        update(self.entry.as_mut(), |entry| {
            entry.lost(messages);
            entry.away(away);
        });
        self.events.push_loss(publisher, messages);
    }

    /// Counts periods without a message of the publisher at the other end of a link, or else of this one.
    pub(super) fn count_missed(&mut self, periods: u64, peer: Option<&Arc<LinkPeer>>) {
        if periods > 0 {
            update(self.entry.as_mut(), |entry| entry.missed_deadlines(periods));
            let peer = peer.map(Arc::clone);
            self.events.push(Event::DeadlineMissed { peer, periods });
        }
    }

    /// Tells the program whether the publisher at the other end of a link, or else this one, is alive, if that has
    /// changed.
    #[inline]
    pub(super) fn report_liveliness(&mut self, change: Option<bool>, peer: Option<&Arc<LinkPeer>>) {
        let Some(is_alive) = change else { return };
        let peer = peer.map(Arc::clone);
        if is_alive {
            return self.events.push(Event::LivelinessRegained { peer });
        }
        update(self.entry.as_mut(), |entry| entry.lost_liveliness());
        self.events.push(Event::LivelinessLost { peer });
    }
}
