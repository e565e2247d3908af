//! When the deadlines and leases of a node are checked, and what wakes it for that.
//!
//! The timer is in the control set, so it wakes the background thread, or else the calls of the program and an event
//! loop that polls the node's descriptor. A node without deadlines and leases has no such timer, and messages do not
//! touch it: the tick at the end of a period finds out whether a message came, and sets the timer to the end of the
//! next period.

use std::collections::BTreeSet;
use std::io;

use sm2_io::{Interest, Timer};
use sm2_proto::{Instant, InterfaceId};

use super::event_sets::NodeSets;
use super::token::QOS_TIMER;

/// The timer of the deadlines and leases of all interfaces of a node.
#[derive(Debug, Default)]
pub(super) struct QosTimer {
    /// `None` until an interface has a deadline or a lease.
    timer: Option<Timer>,
    /// The time that the timer is set to.
    at: Option<Instant>,
    /// The interfaces that have been ticked, or will be.
    interfaces: BTreeSet<InterfaceId>,
}

impl QosTimer {
    /// Makes the timer, before the first interface with a deadline or a lease is declared.
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

    /// An interface has to be ticked at this time. Sets the timer to it, unless it is set to an earlier one.
    //= SM2-QOS-009, SM2-QOS-011
    pub(super) fn tick_at(&mut self, interface: InterfaceId, at: Instant) {
        self.interfaces.insert(interface);
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

    /// The interfaces to tick.
    pub(super) fn interfaces(&self) -> impl Iterator<Item = InterfaceId> {
        self.interfaces.iter().copied()
    }

    /// Ticks an interface no more, because it is gone.
    pub(super) fn remove(&mut self, interface: InterfaceId) {
        self.interfaces.remove(&interface);
    }

    /// Whether the time has come that the timer was set to.
    pub(super) fn fires(&mut self) -> bool {
        let fires = self.timer.as_ref().is_some_and(Timer::drain);
        if fires {
            self.at = None;
        }
        fires
    }
}
