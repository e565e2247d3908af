//! Connecting to a Manager again after a session has ended.
//!
//! Attempts happen when a call drives the node. A timer in the node's epoll set signals the next
//! attempt, so it also wakes a program that polls the node's descriptor. While there is a connection, the same
//! timer tells when to look for room for links.

use std::path::Path;

use sm2_io::{Epoll, Interest, SeqPacket};
use sm2_proto::Refusal;
use sm2_proto::node::{End, Input};

use super::retry::Cause;
use crate::driver::datagram::Incoming;
use crate::driver::inner::Inner;
use crate::driver::sleepers::EventSource;
use crate::driver::token::SESSION;

impl Inner {
    /// Schedules an attempt to connect, unless this side ended the session.
    //= SM2-RES-001
    pub(in crate::driver) fn come_back(&mut self, end: End) {
        if !matches!(end, End::Local(_)) {
            self.reconnect.plan();
        }
    }

    /// Handles the timer: looks for room for links, or tries to connect.
    //= SM2-RES-001, SM2-LNK-010
    pub(in crate::driver) fn on_timer(&mut self, epoll: &Epoll) {
        if !self.reconnect.timer.drain() {
            return;
        }
        if self.session.is_connected() {
            self.state_links();
            return self.drain_session(Incoming::default(), epoll);
        }
        let path: &Path = &self.reconnect.path;
        let connected = SeqPacket::connect(path).and_then(|socket| {
            epoll.add(&socket, SESSION, Interest::READABLE)?;
            Ok(socket)
        });
        match connected {
            Ok(socket) => {
                self.session.connected(socket);
                self.session.tell(Input::Reconnected);
                self.drain_session(Incoming::default(), epoll);
            }
            Err(error) => {
                if self.reconnect.fails(Cause::Connect(error.kind())) {
                    tracing::warn!(
                        path = ?self.reconnect.path, %error,
                        "no Manager: links stay open, and this node tries again"
                    );
                }
                self.reconnect.plan();
            }
        }
        self.sleepers.wake(EventSource::Session);
    }

    /// Handles a refused greeting, which counts as a failed attempt.
    //= SM2-RES-001
    pub(in crate::driver) fn greeting_refused(&mut self, reason: Refusal) {
        if self.session.was_welcomed() && self.reconnect.fails(Cause::Refused(reason.clone())) {
            tracing::warn!(%reason, "the new Manager refused this node: its links stay open, and it tries again");
        }
        self.session.refused = Some(reason);
        self.session.tell(Input::Eof);
        self.sleepers.wake(EventSource::Session);
    }
}
