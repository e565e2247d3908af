//! What other threads tell a Manager's loop.

use std::{io, os::fd::AsFd, sync::Arc, time::Duration};

use sm2_io::{Waker, wait_readable};

/// Ends a Manager's loop, from any thread; also while it stands by.
///
/// Nodes keep their links, and come back when there is a Manager again. If another one stands
/// by for the domain, that is at once: to stop a Manager is not to end its domain.
#[derive(Clone, Debug)]
pub struct Stopper(pub(crate) Arc<Waker>);

impl Stopper {
    /// Asks the loop to end. It says goodbye to every node and removes its socket.
    pub fn stop(&self) {
        self.0.wake();
    }
}

/// Makes a Manager hand over its domain, from any thread (SM2-RES-010).
#[derive(Clone, Debug)]
pub struct HandOver(pub(crate) Arc<Waker>);

impl HandOver {
    /// Asks the loop to give up the domain's lock.
    ///
    /// Whoever waits for it becomes the next Manager: first one that tries to take it, such
    /// as `sm2 manager --replace`; after 100 ms a standby. Sessions go on until that one
    /// serves. If nobody has come after 2 s, the Manager goes on as before. Without effect on
    /// one that stands by, and on one that was handed its socket.
    pub fn start(&self) {
        self.0.wake();
    }
}

/// What a loop listens to. One pair may serve several loops, one after the other.
#[derive(Clone, Debug)]
pub(crate) struct Handles {
    pub(crate) stop: Arc<Waker>,
    pub(crate) hand_over: Arc<Waker>,
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
        })
    }

    pub(crate) fn stopper(&self) -> Stopper {
        Stopper(Arc::clone(&self.stop))
    }

    pub(crate) fn hand_over(&self) -> HandOver {
        HandOver(Arc::clone(&self.hand_over))
    }
}
