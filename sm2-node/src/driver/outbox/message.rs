//! The bytes of one message, and the fields of its header.

use std::os::fd::OwnedFd;

use bytes::Bytes;
use sm2_io::Slot;
use sm2_proto::Instant;
use sm2_proto::limits::SLOT_HEAD;
use sm2_proto::link::{Body, OutboundMessage, SegmentInfo, SlotHead, Status};

use super::message_key::MessageKey;
use crate::pool::Lease;

/// The bytes of one message, in one form or more.
#[derive(Debug, Default)]
pub(crate) struct Forms {
    pub(crate) inline: Option<Bytes>,
    pub(crate) pooled: Option<Lease<Slot>>,
    pub(crate) sealed: Option<OwnedFd>,
}

impl Forms {
    /// A message whose payload is inside the datagram.
    pub(crate) fn inline(payload: Bytes) -> Self {
        Self {
            inline: Some(payload),
            ..Self::default()
        }
    }

    /// A message whose payload is in this slot alone.
    pub(crate) fn in_slot(lease: Lease<Slot>) -> Self {
        Self {
            pooled: Some(lease),
            ..Self::default()
        }
    }

    /// Whether the payload is in a slot alone.
    #[inline]
    pub(super) const fn are_slot_alone(&self) -> bool {
        self.inline.is_none() && self.sealed.is_none() && self.pooled.is_some()
    }

    /// Whether there is no message, because no link needs it.
    pub(crate) const fn is_empty(&self) -> bool {
        self.inline.is_none() && self.pooled.is_none() && self.sealed.is_none()
    }
}

/// The fields of a message's header.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Label {
    pub(crate) id: u64,
    pub(crate) time: Instant,
    pub(crate) len: u64,
}

#[derive(Debug, Default)]
pub(super) struct StoredMessage {
    pub(super) forms: Forms,
    pub(super) label: Label,
    pub(super) holders: u32,
    /// Whether a link ended with the message.
    pub(super) orphaned: bool,
}

impl StoredMessage {
    /// The message for a link, with this body.
    pub(super) fn outbound(&self, key: MessageKey, status: Status, body: Body) -> OutboundMessage {
        OutboundMessage {
            key: key.to_raw(),
            id: self.label.id,
            time: self.label.time,
            status,
            len: self.label.len,
            body,
        }
    }
}

/// Writes the head that receivers of the ring lane read.
//= SM2-RNG-004
pub(super) fn write_head(lease: &mut Lease<Slot>, label: Label, status: Status) {
    let Label { id, time, len } = label;
    let slot = lease.memory.len_bytes();
    if let Some(place) = lease.memory.bytes_mut(slot).last_chunk_mut::<SLOT_HEAD>() {
        *place = SlotHead {
            id,
            time,
            len,
            status,
        }
        .to_bytes();
    }
}

/// The segment of a slot, as messages refer to it.
#[inline]
pub(in crate::driver) const fn info<M>(lease: &Lease<M>) -> SegmentInfo {
    SegmentInfo {
        id: lease.segment.id,
        stride: lease.segment.stride,
        slots: lease.segment.slots,
    }
}
