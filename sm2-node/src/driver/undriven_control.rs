//! The control side of a node without a background thread, as a wait set drives it.

use std::os::fd::{AsFd, BorrowedFd};
use std::sync::Arc;

use super::event_sets::NodeSets;
use super::shared_interface::ControlSide;

/// The control side of a node without a background thread.
#[derive(Debug)]
pub(crate) struct UndrivenControl {
    sets: Arc<NodeSets>,
    control: Arc<dyn ControlSide>,
}

impl UndrivenControl {
    pub(super) fn new(sets: &Arc<NodeSets>, control: Arc<dyn ControlSide>) -> Self {
        let sets = Arc::clone(sets);
        Self { sets, control }
    }

    /// Whether both belong to one node.
    pub(crate) fn is_same(&self, other: &Self) -> bool {
        self.is_of(&other.sets)
    }

    pub(super) fn is_of(&self, sets: &Arc<NodeSets>) -> bool {
        Arc::ptr_eq(&self.sets, sets)
    }

    /// Does the work of all pending events. Returns whether the kernel had no memory for it.
    pub(crate) fn drive(&self) -> bool {
        self.control.drive()
    }
}

/// Readable when the control side has work.
impl AsFd for UndrivenControl {
    fn as_fd(&self) -> BorrowedFd<'_> {
        self.sets.control.as_fd()
    }
}
