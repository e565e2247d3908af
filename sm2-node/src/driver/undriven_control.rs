//! The control side of a node without a background thread, as a wait set drives it.

use std::os::fd::{AsFd, BorrowedFd};
use std::sync::Arc;

use super::event_sets::NodeSets;
use super::shared_interface::{ControlSide, SharedInterface};
use super::shared_node::SharedNode;

/// The control side of a node without a background thread.
#[derive(Debug)]
pub(crate) struct UndrivenControl {
    sets: Arc<NodeSets>,
    control: Arc<dyn ControlSide>,
}

impl UndrivenControl {
    /// The control side of the node that has this interface. `None` if the node has a background thread.
    pub(crate) fn of_interface(interface: &SharedInterface) -> Option<Self> {
        Self::new(&interface.sets.node, || interface.control_side())
    }

    /// The control side of a node. `None` if the node has a background thread.
    pub(crate) fn of_node(node: &SharedNode) -> Option<Self> {
        Self::new(&node.sets, || node.control_side())
    }

    fn new(sets: &Arc<NodeSets>, control: impl FnOnce() -> Arc<dyn ControlSide>) -> Option<Self> {
        (!sets.has_background()).then(|| Self {
            sets: Arc::clone(sets),
            control: control(),
        })
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
