//! When the deadlines of a node are checked, and what wakes it for that.
//!
//! The timer is in the control set, so it wakes the background thread, or else the calls of the program and an event
//! loop that polls the node's descriptor. A node without deadlines has no such timer, and messages do not touch it: the
//! tick at the end of a period finds out whether a message came, and sets the timer to the end of the next period.

use std::collections::BTreeSet;
use std::io;

use sm2_io::{Interest, Timer};
use sm2_proto::{Instant, InterfaceId};

use super::event_sets::NodeSets;
use super::token::QOS_TIMER;

/// The timer of the deadlines of all interfaces of a node.
#[derive(Debug, Default)]
pub(super) struct QosTimer {
    /// `None` until an interface has a deadline.
    timer: Option<Timer>,
    /// The time to which the timer is set.
    at: Option<Instant>,
    /// The interfaces that have deadlines.
    pub(super) interfaces: BTreeSet<InterfaceId>,
}

impl QosTimer {
    /// Makes the timer, before the first interface with a deadline is declared.
    ///
    /// # Errors
    ///
    /// Errors of `timerfd_create(2)` and `epoll_ctl(2)`.
    pub(super) fn prepare(&mut self, sets: &NodeSets) -> io::Result<()> {
        if self.timer.is_none() {
            let timer = Timer::new()?;
            sets.control.add(&timer, QOS_TIMER, Interest::READABLE)?;
            self.timer = Some(timer);
        }
        Ok(())
    }

    /// Sets the timer to this time, unless it is set to an earlier one.
    pub(super) fn set(&mut self, at: Instant) {
        let Some(timer) = &self.timer else { return };
        if self.at.is_some_and(|earlier| earlier <= at) {
            return;
        }
        match timer.set(Some(at)) {
            Ok(()) => self.at = Some(at),
            Err(error) => {
                tracing::error!(%error, "cannot set a timer: this node does not notice missed deadlines");
            }
        }
    }

    /// Whether the time has come to which the timer was set.
    pub(super) fn fires(&mut self) -> bool {
        let fires = self.timer.as_ref().is_some_and(Timer::drain);
        if fires {
            self.at = None;
        }
        fires
    }
}
