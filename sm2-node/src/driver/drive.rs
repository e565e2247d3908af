//! Driving the control side: the session, the way back to a Manager, and links that need more than calls do for them.

use std::fmt::Display;
use std::mem;
use std::sync::Arc;
use std::time::Duration;

use sm2_io::Event;

use super::control::Control;
use super::event_sets::NodeSets;
use super::limits::{ENDS, put_ends_last};
use super::link::LinkDriver;
use super::shared_interface::SharedInterface;
use super::token::{LEFTOVERS, LinkToken, QOS_TIMER, SESSION, TIMER};

impl Control {
    /// Does the work of all pending events of the control set. Does a bounded amount of work and does not wait.
    pub(super) fn drive(&mut self, sets: &NodeSets) {
        self.short_of_memory = false;
        self.session.watch_again(sets);
        if let Err(error) = sets.control.wait(&mut self.events, Some(Duration::ZERO)) {
            return self.not_ready(&error);
        }
        // Taken out, because each event changes the node.
        let mut ready = mem::take(&mut self.ready);
        ready.extend(self.events.iter());
        put_ends_last(&mut ready);
        let mut ends = 0;
        while let Some(event) = ready.pop() {
            match event.token {
                SESSION => self.on_session_event(event, sets),
                TIMER => self.on_timer(sets),
                QOS_TIMER => self.on_qos_timer(sets),
                // The next drive gives back memory before it locks the node.
                LEFTOVERS => {}
                _ => ends += usize::from(self.on_link_event(event, sets)),
            }
            if ends == ENDS {
                // The set reports the others again.
                ready.clear();
            }
        }
        self.ready = ready;
    }

    /// The interfaces whose links have events that calls handle.
    pub(super) fn ready_interfaces(&mut self, sets: &NodeSets) -> Vec<Arc<SharedInterface>> {
        match sets.ready_interfaces(&mut self.events) {
            Ok(ids) => (ids.iter())
                .filter_map(|id| self.interfaces.get(id).map(Arc::clone))
                .collect(),
            Err(error) => {
                self.not_ready(&error);
                Vec::new()
            }
        }
    }

    /// Handles an event of a link. Returns whether the link has ended.
    fn on_link_event(&mut self, event: Event, sets: &NodeSets) -> bool {
        let token = LinkToken(event.token);
        let Some(&interface) = self.routes.get(&token) else {
            return false;
        };
        let result = self.with_interface(interface, sets, |interface, context| {
            interface.on_event(token, event, context);
            interface.after_background_event(token, context);
            let link = interface.links.get(token);
            let has_ended = link.is_none_or(|it| it.end().is_some());
            (link.is_some_and(LinkDriver::is_short_of_memory), has_ended)
        });
        let (is_short, has_ended) = result.unwrap_or_default();
        if is_short {
            self.not_ready(&"no memory for a link");
        }
        has_ended
    }

    /// Ticks all interfaces that have a deadline or a lease.
    //= SM2-QOS-009, SM2-QOS-011
    pub(super) fn on_qos_timer(&mut self, sets: &NodeSets) {
        if !self.qos_timer.fires() {
            return;
        }
        let now = sm2_io::clock::now();
        let all: Vec<_> = self.qos_timer.interfaces().collect();
        for id in all {
            let Some(interface) = self.interfaces.get(&id).map(Arc::clone) else {
                self.qos_timer.remove(id);
                continue;
            };
            if let Some(results) = interface.tick(now) {
                self.handle(id, results, sets);
            }
        }
    }

    /// Notes that a descriptor could not be used, although it was ready.
    //= SM2-TRN-013
    pub(super) fn not_ready(&mut self, reason: &dyn Display) {
        self.short_of_memory = true;
        if let Some(count) = self.shortages.count(sm2_io::clock::now()) {
            tracing::warn!(node = %self.name, %reason, count, "cannot use a socket now: the node tries again");
        }
    }
}
