//! Handles that let other threads control a Manager's loop.

use std::{io, os::fd::AsFd, sync::Arc, time::Duration};

use sm2_io::{Waker, wait_readable};

/// Ends a Manager's loop, from any thread, including while it stands by.
///
/// Nodes keep their links and reconnect when another Manager serves. If one stands by for the domain, they
/// reconnect at once. Stopping a Manager does not end its domain.
#[derive(Clone, Debug)]
pub struct Stopper(pub(crate) Arc<Waker>);

impl Stopper {
    /// Asks the loop to end. A Manager that serves says goodbye to every node and removes its socket.
    pub fn stop(&self) {
        self.0.wake();
    }
}

/// Makes a Manager hand over its domain, from any thread (SM2-RES-009).
#[derive(Clone, Debug)]
pub struct HandOver(pub(crate) Arc<Waker>);

impl HandOver {
    /// Asks the loop to give up the domain's lock.
    ///
    /// The next Manager is the first process to take the lock: for 100 ms one that tries directly, such as
    /// `sm2 manager --replace`; then also a standby. Sessions continue until the next Manager serves. If none
    /// has come after 2 s, this one continues as before.
    ///
    /// Has no effect on a Manager that stands by, or on one that serves an adopted socket (socket
    /// activation).
    pub fn start(&self) {
        self.0.wake();
    }
}

/// Makes a Manager read the access policy of its domain again, from any thread (SM2-ACC-013).
#[derive(Clone, Debug)]
pub struct PolicyReloader(pub(crate) Arc<Waker>);

impl PolicyReloader {
    /// Asks the loop to read the policy. The log says when it is applied. If it cannot be used, the policy before
    /// stays in force, and the log says why.
    ///
    /// A Manager that stands by reads the policy when it takes over.
    pub fn start(&self) {
        self.0.wake();
    }
}

/// The wakers of a loop. One pair can serve several loops, one after the other.
#[derive(Clone, Debug)]
pub(crate) struct Handles {
    pub(crate) stop: Arc<Waker>,
    pub(crate) hand_over: Arc<Waker>,
    pub(crate) reload: Arc<Waker>,
}

impl Handles {
    /// Whether the loop is to end.
    pub(crate) fn is_stopped(&self) -> io::Result<bool> {
        wait_readable(&[self.stop.as_fd()], Some(Duration::ZERO))
    }

    pub(crate) fn new() -> io::Result<Self> {
        Ok(Self {
            stop: Arc::new(Waker::new()?),
            hand_over: Arc::new(Waker::new()?),
            reload: Arc::new(Waker::new()?),
        })
    }

    pub(crate) fn stopper(&self) -> Stopper {
        Stopper(Arc::clone(&self.stop))
    }

    pub(crate) fn hand_over(&self) -> HandOver {
        HandOver(Arc::clone(&self.hand_over))
    }

    pub(crate) fn policy_reload(&self) -> PolicyReloader {
        PolicyReloader(Arc::clone(&self.reload))
    }
}
