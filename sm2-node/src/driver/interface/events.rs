//! Events for the program: links that open and end, and losses.

use std::sync::Arc;

use sm2_proto::control::LinkPeer;

use super::DeclaredInterface;
use super::event_queue::EventQueue;
use crate::Event;
use crate::driver::counters::update;
use crate::driver::link::LinkDriver;

impl DeclaredInterface {
    /// Collects events from now on. The first ones are the links that are open.
    pub(crate) fn enable_events(&mut self) {
        if !self.events.enable() {
            return;
        }
        for link in self.links.iter_mut() {
            // Losses before now are not events.
            link.take_new_drops();
            if link.is_open() {
                link.has_joined = true;
                let peer = Arc::clone(&link.origin.peer);
                self.events.push(Event::Joined { peer });
            }
        }
    }

    /// Whether threads have to be woken for an event.
    #[inline]
    pub(in crate::driver) const fn has_fresh_events(&mut self) -> bool {
        self.events.take_fresh()
    }

    /// Notes the messages that subscribers do not get.
    #[inline]
    pub(super) fn report_drops(&mut self) {
        if self.events.is_enabled() {
            for link in self.links.iter_mut() {
                self.events.report_drops(link);
            }
        }
    }

    /// Counts messages of this publisher that came and that the application will not get.
    pub(crate) fn lose(&mut self, publisher: &Arc<LinkPeer>, messages: u64) {
        if messages == 0 {
            return;
        }
        self.lost = self.lost.saturating_add(messages);
        update(self.entry.as_mut(), |entry| entry.lost(messages));
        self.events.push_loss(publisher, messages);
    }
}

impl EventQueue {
    /// Notes that a link has opened or ended, when that is noticed first, and what was lost on it.
    pub(super) fn report_state(&mut self, link: &mut LinkDriver) {
        if link.is_open() && !link.has_joined {
            link.has_joined = true;
            let peer = Arc::clone(&link.origin.peer);
            self.push(Event::Joined { peer });
        }
        if self.is_enabled() {
            self.report_drops(link);
        }
        if let Some(end) = link.end()
            && link.has_joined
        {
            link.has_joined = false;
            let peer = Arc::clone(&link.origin.peer);
            self.push(Event::Left { peer, end });
        }
    }

    /// Notes the messages that the subscriber of a link does not get.
    fn report_drops(&mut self, link: &mut LinkDriver) {
        let dropped = link.take_new_drops();
        self.push_loss(&link.origin.peer, dropped);
    }
}
