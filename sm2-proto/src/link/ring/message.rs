//! Inputs and outputs of the sender's side of a ring.

use super::super::{Body, Misuse, OutboundMessage, SegmentInfo};
use crate::Violation;

/// A message to send, as the ring lane stores it. Its payload and its [head](super::SlotHead) are
/// already in the slot: see [`Link::send_in_slot`](crate::link::Link::send_in_slot).
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct RingMessage {
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

/// The reason why [`RingSender::send`](super::RingSender::send) failed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(in crate::link) enum RingSendError {
    /// Nothing was sent, and nothing has changed.
    Misuse(Misuse),
    /// The receiver violated SPEC. The message is recorded, and the end of the link settles it.
    Violation(Violation),
    /// The message is in the ring, but the receiver has stopped (SM2-RNG-010). The end of the link
    /// settles the message.
    Stopped,
}

impl From<Misuse> for RingSendError {
    fn from(misuse: Misuse) -> Self {
        Self::Misuse(misuse)
    }
}

impl From<Violation> for RingSendError {
    fn from(violation: Violation) -> Self {
        Self::Violation(violation)
    }
}
