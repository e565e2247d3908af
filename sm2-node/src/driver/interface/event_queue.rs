//! The events of an interface that its program has not taken.

use std::collections::VecDeque;
use std::sync::Arc;

use sm2_proto::control::LinkPeer;

use crate::Event;
use crate::driver::limits::EVENTS;

/// The events of an interface that its program has not taken, at most [`EVENTS`]. Empty until the program asks for
/// events.
#[derive(Debug, Default)]
pub(crate) struct EventQueue {
    /// `None` until the program asks for events.
    events: Option<VecDeque<Event>>,
    /// How many events were dropped because the program did not take them.
    dropped: u64,
    /// Whether an event has come that no thread was woken for yet.
    is_fresh: bool,
}

impl EventQueue {
    /// Collects events from now on. Returns whether it did not before.
    pub(super) fn enable(&mut self) -> bool {
        let was_enabled = self.events.is_some();
        self.events.get_or_insert_default();
        !was_enabled
    }

    pub(super) const fn is_enabled(&self) -> bool {
        self.events.is_some()
    }

    pub(super) fn push(&mut self, event: Event) {
        let Some(events) = &mut self.events else {
            return;
        };
        if events.len() == EVENTS {
            events.pop_front();
            self.dropped += 1;
        }
        events.push_back(event);
        self.is_fresh = true;
    }

    /// Adds to the last event, if that is a loss on the same link: a slow receiver may lose messages one by one.
    pub(super) fn push_loss(&mut self, peer: &Arc<LinkPeer>, lost: u64) {
        if lost == 0 {
            return;
        }
        let last = self.events.as_mut().and_then(VecDeque::back_mut);
        match last {
            Some(Event::Lost {
                peer: same,
                messages,
            }) if Arc::ptr_eq(same, peer) => {
                // A peer states some of these numbers.
                *messages = messages.saturating_add(lost);
                self.is_fresh = true;
            }
            _ => self.push(Event::Lost {
                peer: Arc::clone(peer),
                messages: lost,
            }),
        }
    }

    pub(crate) fn pop(&mut self) -> Option<Event> {
        self.events.as_mut()?.pop_front()
    }

    pub(super) fn has_any(&self) -> bool {
        (self.events.as_ref()).is_some_and(|events| !events.is_empty())
    }

    pub(crate) const fn dropped(&self) -> u64 {
        self.dropped
    }

    /// Whether threads have to be woken for an event.
    #[inline]
    pub(in crate::driver) const fn take_fresh(&mut self) -> bool {
        std::mem::replace(&mut self.is_fresh, false)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::driver::origin::any_peer;

    #[test]
    fn losses_are_added_up_to_the_greatest_number() {
        let peer = any_peer();
        let mut queue = EventQueue::default();
        queue.enable();
        for lost in [2, 0, u64::MAX - 3, 4] {
            queue.push_loss(&peer, lost);
        }
        let Some(Event::Lost { messages, .. }) = queue.pop() else {
            panic!("one loss");
        };
        assert_eq!(messages, u64::MAX);
        assert!(queue.pop().is_none());
    }
}
