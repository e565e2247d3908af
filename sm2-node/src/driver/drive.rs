//! Driving a node: reading and writing the sockets that are ready, and changing an interface.

use std::fmt::Display;
use std::time::Duration;

use sm2_io::Epoll;
use sm2_proto::{Instant, InterfaceId};

use super::context::Context;
use super::datagram::Incoming;
use super::inner::Inner;
use super::interface::Interface;
use super::limits::SOCKETS_WAIT_NS;
use super::link::LinkDriver;
use super::sleepers::EventSource;
use super::token::{LinkToken, SESSION, TIMER};

impl Inner {
    /// Drives the node if its last drive was some time ago. This avoids a system call for each
    /// message of a ring. Returns whether the node was driven.
    pub(crate) fn drive_if_due(&mut self, now: Instant, epoll: &Epoll) -> bool {
        self.now = now;
        let due = now.0.saturating_sub(self.last_drive.0) >= SOCKETS_WAIT_NS;
        if due {
            self.last_drive = now;
            self.drive(epoll);
        }
        due
    }

    /// Reads from readable sockets and writes to writable ones. Does a bounded amount of work and
    /// does not wait.
    pub(crate) fn drive(&mut self, epoll: &Epoll) {
        self.short_of_memory = false;
        self.session.watch_again(epoll);
        if let Err(error) = epoll.wait(&mut self.events, Some(Duration::ZERO)) {
            return self.not_ready(&error);
        }
        self.ready.extend(self.events.iter());
        while let Some(event) = self.ready.pop() {
            if event.token == SESSION {
                self.on_session_event(event, epoll);
                if self.session.is_short_of_memory() {
                    self.not_ready(&"no memory for the session");
                }
                continue;
            }
            if event.token == TIMER {
                self.on_timer(epoll);
                continue;
            }
            let token = LinkToken(event.token);
            if let Some(&interface) = self.routes.get(&token) {
                let is_short = self.with_interface(interface, epoll, |interface, context| {
                    interface.on_event(token, event, context);
                    let link = interface.link(token);
                    link.is_some_and(LinkDriver::is_short_of_memory)
                });
                if is_short == Some(true) {
                    self.not_ready(&"no memory for a link");
                }
                self.sleepers.wake(EventSource::Interface(interface));
            }
        }
    }

    /// Notes that a socket could not be used, although it was ready.
    //= SM2-TRN-014
    fn not_ready(&mut self, reason: &dyn Display) {
        self.short_of_memory = true;
        if let Some(count) = self.shortages.note(sm2_io::clock::now()) {
            tracing::warn!(node = %self.name, %reason, count, "cannot use a socket now: the node tries again");
        }
    }

    /// Drives the node before it sends on a link. On the ring lane, drives it only if the last
    /// drive was some time ago.
    pub(crate) fn drive_for_link(&mut self, id: InterfaceId, token: LinkToken, epoll: &Epoll) {
        let link = self.interfaces.get(&id).and_then(|it| it.link(token));
        let is_call_free = link.is_some_and(|it| !it.is_woken_by_socket());
        if !self.drive_if_due(sm2_io::clock::now(), epoll) && !is_call_free {
            self.drive(epoll);
        }
    }

    /// Harvests the messages that came back to an interface, changes the interface, and tells the
    /// Manager which of its links have ended.
    #[inline]
    pub(crate) fn with_interface<R>(
        &mut self,
        id: InterfaceId,
        epoll: &Epoll,
        change: impl FnOnce(&mut Interface, &mut Context<'_>) -> R,
    ) -> Option<R> {
        self.with_interface_unharvested(id, epoll, |interface, context| {
            interface.harvest(context);
            change(interface, context)
        })
    }

    /// The same as [`with_interface`](Self::with_interface), but without harvesting.
    #[inline]
    pub(crate) fn with_interface_unharvested<R>(
        &mut self,
        id: InterfaceId,
        epoll: &Epoll,
        change: impl FnOnce(&mut Interface, &mut Context<'_>) -> R,
    ) -> Option<R> {
        let interface = self.interfaces.get_mut(&id)?;
        let mut context = Context {
            epoll,
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
            self.drain_session(Incoming::default(), epoll);
        }
        Some(result)
    }
}
