//! Driving a node: reading and writing the sockets that are ready, and changing an interface.

use std::fmt::Display;
use std::mem;
use std::time::Duration;

use sm2_io::Event;
use sm2_proto::{Instant, InterfaceId};

use super::context::Context;
use super::datagram::Incoming;
use super::event_sets::EventSets;
use super::inner::Inner;
use super::interface::Interface;
use super::limits::SOCKETS_WAIT_NS;
use super::link::LinkDriver;
use super::sleepers::EventSource;
use super::token::{CONTROL, LinkToken, SESSION, TIMER};

/// A part of the work of a node.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Side {
    /// The descriptors that wake calls.
    Calls,
    /// The descriptors that wake the background thread.
    Control,
}

impl Inner {
    /// Drives the node if its last drive was some time ago. This avoids a system call for each
    /// message of a ring. Returns whether the node was driven.
    pub(crate) fn drive_if_due(&mut self, now: Instant, sets: &EventSets) -> bool {
        self.now = now;
        let due = now.0.saturating_sub(self.last_drive.0) >= SOCKETS_WAIT_NS;
        if due {
            self.last_drive = now;
            self.drive(sets);
        }
        due
    }

    /// Reads from the readable sockets that wake calls, and writes to the writable ones. Does a bounded amount of
    /// work and does not wait.
    pub(crate) fn drive(&mut self, sets: &EventSets) {
        self.short_of_memory = false;
        self.drive_side(Side::Calls, sets);
    }

    /// Does the work of the control side: the session, the way back to a Manager, and links that need more than
    /// calls do for them. Returns whether the kernel had no memory for it.
    pub(super) fn drive_control(&mut self, sets: &EventSets) -> bool {
        let was_short = mem::take(&mut self.short_of_memory);
        self.session.watch_again(sets);
        self.drive_side(Side::Control, sets);
        mem::replace(&mut self.short_of_memory, was_short)
    }

    /// Drives both sides.
    pub(crate) fn drive_all(&mut self, sets: &EventSets) {
        self.drive(sets);
        if sets.has_background() {
            self.drive_control(sets);
        }
    }

    fn drive_side(&mut self, side: Side, sets: &EventSets) {
        let set = match side {
            Side::Calls => &sets.calls,
            Side::Control => &sets.control,
        };
        if let Err(error) = set.wait(&mut self.events, Some(Duration::ZERO)) {
            return self.not_ready(&error);
        }
        // Taken out, because the control set may be driven in between.
        let mut ready = mem::take(&mut self.ready);
        ready.extend(self.events.iter());
        while let Some(event) = ready.pop() {
            match event.token {
                CONTROL => {
                    self.session.watch_again(sets);
                    self.drive_side(Side::Control, sets);
                }
                SESSION => self.on_session_event(event, sets),
                TIMER => self.on_timer(sets),
                _ => self.on_link_event(side, event, sets),
            }
        }
        self.ready = ready;
    }

    fn on_link_event(&mut self, side: Side, event: Event, sets: &EventSets) {
        let token = LinkToken(event.token);
        let Some(&interface) = self.routes.get(&token) else {
            return;
        };
        let is_short = self.with_interface(interface, sets, |interface, context| {
            interface.on_event(token, event, context);
            if side == Side::Control {
                interface.rest_in_background(token, context);
            }
            let link = interface.link(token);
            link.is_some_and(LinkDriver::is_short_of_memory)
        });
        if is_short == Some(true) {
            self.not_ready(&"no memory for a link");
        }
        self.sleepers.wake(EventSource::Interface(interface));
    }

    /// Notes that a socket could not be used, although it was ready.
    //= SM2-TRN-014
    pub(super) fn not_ready(&mut self, reason: &dyn Display) {
        self.short_of_memory = true;
        if let Some(count) = self.shortages.note(sm2_io::clock::now()) {
            tracing::warn!(node = %self.name, %reason, count, "cannot use a socket now: the node tries again");
        }
    }

    /// Drives the node before it sends on a link. On the ring lane, drives it only if the last
    /// drive was some time ago.
    pub(crate) fn drive_for_link(&mut self, id: InterfaceId, token: LinkToken, sets: &EventSets) {
        let link = self.interfaces.get(&id).and_then(|it| it.link(token));
        let is_call_free = link.is_some_and(|it| !it.is_woken_by_socket());
        if !self.drive_if_due(sm2_io::clock::now(), sets) && !is_call_free {
            self.drive(sets);
        }
    }

    /// Harvests the messages that came back to an interface, changes the interface, and tells the
    /// Manager which of its links have ended.
    #[inline]
    pub(crate) fn with_interface<R>(
        &mut self,
        id: InterfaceId,
        sets: &EventSets,
        change: impl FnOnce(&mut Interface, &mut Context<'_>) -> R,
    ) -> Option<R> {
        self.with_interface_unharvested(id, sets, |interface, context| {
            interface.harvest(context);
            change(interface, context)
        })
    }

    /// The same as [`with_interface`](Self::with_interface), but without harvesting.
    #[inline]
    pub(crate) fn with_interface_unharvested<R>(
        &mut self,
        id: InterfaceId,
        sets: &EventSets,
        change: impl FnOnce(&mut Interface, &mut Context<'_>) -> R,
    ) -> Option<R> {
        let interface = self.interfaces.get_mut(&id)?;
        let mut context = Context {
            sets,
            buffer: &mut self.buffer,
            counting: &mut self.counting,
            now: self.now,
            stirred: false,
        };
        let result = change(interface, &mut context);
        if context.stirred {
            self.sleepers.wake(EventSource::Interface(id));
        }
        while let Some(token) = interface.gone.pop() {
            self.routes.remove(&token);
        }
        if !interface.unreported_ends.is_empty() {
            for (link, code) in std::mem::take(&mut interface.unreported_ends) {
                self.session.unlinked(id, link, code);
            }
            // A thread that spins waits for the end of all links.
            self.sleepers.wake(EventSource::Session);
            self.drain_session(Incoming::default(), sets);
        }
        Some(result)
    }
}
