//! Inputs and outputs of the sender's side of a ring.

use super::super::{Body, Misuse, OutboundMessage, segments::SegmentInfo};
use crate::Violation;

/// A message to send, as the ring lane stores it. Its payload and its [head](super::SlotHead) are
/// already in the slot.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(in crate::link) struct RingMessage {
    /// The same as [`OutboundMessage::key`].
    pub key: u64,
    /// The publisher's count of its publications, or the caller's count of its calls: both increase
    /// strictly. For a reply, the number of the call.
    pub id: u64,
    /// The length of the payload, in bytes.
    pub len: u64,
    /// The segment, which has to be [attached](super::super::Input::Attach).
    pub segment: SegmentInfo,
    /// The slot, from 0.
    pub slot: u32,
}

impl RingMessage {
    /// Returns `None` if the payload is not in a slot.
    #[inline]
    pub(in crate::link) const fn of(message: &OutboundMessage) -> Option<Self> {
        let Body::Pooled { segment, slot } = message.body else {
            return None;
        };
        Some(Self {
            key: message.key,
            id: message.id,
            len: message.len,
            segment,
            slot,
        })
    }
}

/// A frame about segments that the sender has to send over the socket.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(in crate::link) enum Step {
    Attach(SegmentInfo),
    Detach(u32),
}

/// The reason why a message was not sent.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(in crate::link) enum Unsent {
    Misuse(Misuse),
    Violation(Violation),
    /// The receiver has stopped (SM2-RNG-011).
    Stopped,
}

impl From<Misuse> for Unsent {
    fn from(misuse: Misuse) -> Self {
        Self::Misuse(misuse)
    }
}

impl From<Violation> for Unsent {
    fn from(violation: Violation) -> Self {
        Self::Violation(violation)
    }
}
