//! The outputs that the driver has not taken yet.

use alloc::collections::VecDeque;

use super::Output;
use crate::{
    NodeId,
    control::{ToNode, encode_to_node},
};

/// The outputs, the oldest first.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub(super) struct Outbox(pub(super) VecDeque<Output>);

impl Outbox {
    pub(super) const fn new() -> Self {
        Self(VecDeque::new())
    }

    /// Sends a frame to a session that is not over.
    pub(super) fn send(&mut self, session: NodeId, frame: &ToNode) {
        let frame = encode_to_node(frame);
        self.push(Output::Send { session, frame });
    }

    pub(super) fn push(&mut self, output: Output) {
        self.0.push_back(output);
    }

    pub(super) fn extend(&mut self, outputs: impl IntoIterator<Item = Output>) {
        self.0.extend(outputs);
    }
}
