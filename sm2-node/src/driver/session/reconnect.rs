//! Connecting to a Manager again after a session has ended.
//!
//! A timer in the control set signals the next attempt. It wakes the background thread, or else the calls of the
//! program and an event loop that polls the node's descriptor. While there is a connection, the same timer tells when
//! to look for room for links.

use std::path::Path;

use sm2_io::{Interest, SeqPacket};
use sm2_proto::Refusal;
use sm2_proto::node::{End, Input};

use super::retry::Cause;
use crate::driver::control::Control;
use crate::driver::datagram::Incoming;
use crate::driver::event_sets::NodeSets;
use crate::driver::token::SESSION;

impl Control {
    /// Schedules an attempt to connect, unless this side ended the session.
    //= SM2-RES-001
    pub(in crate::driver) fn come_back(&mut self, end: End) {
        if !matches!(end, End::Local(_)) {
            self.reconnect.plan();
        }
    }

    /// Handles the timer: looks for room for links, or tries to connect.
    //= SM2-RES-001, SM2-LNK-007
    pub(in crate::driver) fn on_timer(&mut self, sets: &NodeSets) {
        if !self.reconnect.timer.drain() {
            return;
        }
        if self.session.is_connected() {
            self.state_links();
            return self.drain_session(Incoming::default(), sets);
        }
        let path: &Path = &self.reconnect.path;
        let connected = SeqPacket::connect(path).and_then(|socket| {
            sets.control.add(&socket, SESSION, Interest::READABLE)?;
            Ok(socket)
        });
        self.sleepers.wake();
        match connected {
            Ok(socket) => {
                self.session.connected(socket);
                self.session.tell(Input::Reconnected);
                self.drain_session(Incoming::default(), sets);
            }
            Err(error) => {
                self.reconnect.plan();
                if self.reconnect.fails(Cause::Connect(error.kind())) {
                    tracing::warn!(
                        path = ?self.reconnect.path, %error,
                        "no Manager: links stay open, and this node tries again"
                    );
                }
            }
        }
    }

    /// Handles a refused greeting, which counts as a failed attempt.
    //= SM2-RES-001
    pub(in crate::driver) fn greeting_refused(&mut self, reason: Refusal) {
        self.session.refused = Some(reason.clone());
        self.session.tell(Input::Eof);
        self.sleepers.wake();
        if self.session.was_welcomed() && self.reconnect.fails(Cause::Refused(reason.clone())) {
            tracing::warn!(%reason, "the new Manager refused this node: its links stay open, and it tries again");
        }
    }
}
