//! A descriptor that lets a wait set wait for the control side of a node: a sleeper that stays registered.

use std::io;
use std::os::fd::{AsFd, BorrowedFd};
use std::sync::Arc;

use sm2_io::Waker;

use super::shared_node::{NodeState, SharedNode};

/// A descriptor that becomes readable when the control side of a node may have changed.
#[derive(Debug)]
pub(crate) struct ControlBell {
    node: Arc<NodeState>,
    waker: Arc<Waker>,
}

impl ControlBell {
    /// Creates a bell that is already signalled, because there may already be a change.
    pub(crate) fn new(node: &SharedNode) -> io::Result<Self> {
        let bell = Self {
            node: Arc::clone(&node.state),
            waker: node.lock().sleepers.enter()?,
        };
        bell.ring();
        Ok(bell)
    }

    /// Resets the bell, so that it becomes readable at the next change.
    pub(crate) fn clear(&self) {
        self.node.lock().sleepers.clear(&self.waker);
    }

    /// Signals the bell, because there may be another change.
    pub(crate) fn ring(&self) {
        self.node.lock().sleepers.wake();
    }
}

impl AsFd for ControlBell {
    fn as_fd(&self) -> BorrowedFd<'_> {
        self.waker.as_fd()
    }
}

impl Drop for ControlBell {
    fn drop(&mut self) {
        // In a child that was made by `fork(2)`, another thread of the parent may have held the lock.
        if !self.node.is_inherited() {
            self.node.lock().sleepers.leave(&self.waker);
        }
    }
}
