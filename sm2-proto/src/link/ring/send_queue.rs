//! Messages of a caller or server that are queued until a ring has room.
//!
//! No call and no reply is refused for lack of room: a message that the ring cannot take yet is
//! queued here in order. The limit of calls bounds the queue.

use alloc::collections::VecDeque;

use super::{super::Misuse, message::RingMessage};
use crate::{
    limits::{CALLS_MAX, MESSAGE_MAX, RING_SEGMENTS_MAX, SLOT_HEAD},
    link::segments::Geometry,
};

/// A queue of messages for a ring, the oldest first.
#[derive(Clone, Debug, Default, PartialEq, Eq, Hash)]
pub(in crate::link) struct SendQueue {
    messages: VecDeque<RingMessage>,
    /// The id of the last message that was queued.
    last_id: Option<u64>,
    /// Whether the last attempt to send the first message found no room in the ring.
    pub(in crate::link) is_full: bool,
}

impl SendQueue {
    /// Checks the properties of a message that do not change until it is sent.
    //= SM2-RNG-003, SM2-PAY-008
    pub(in crate::link) fn check(message: &RingMessage) -> Result<(), Misuse> {
        let info = &message.segment;
        let geometry = Geometry::new(info.stride, info.slots).ok_or(Misuse::BadSegment)?;
        if info.id >= RING_SEGMENTS_MAX {
            return Err(Misuse::BadSegment);
        }
        if geometry.offset(message.slot).is_none() {
            return Err(Misuse::SlotOutside);
        }
        if message.len > MESSAGE_MAX.min(info.stride - SLOT_HEAD as u64) {
            return Err(Misuse::TooLong);
        }
        Ok(())
    }

    /// Notes a message that is sent without waiting here.
    pub(in crate::link) const fn note(&mut self, id: u64) {
        self.last_id = Some(id);
    }

    pub(in crate::link) fn push(&mut self, message: RingMessage) {
        self.note(message.id);
        self.messages.push_back(message);
    }

    pub(in crate::link) fn front(&self) -> Option<&RingMessage> {
        self.messages.front()
    }

    pub(in crate::link) fn pop(&mut self) {
        self.messages.pop_front();
    }

    pub(in crate::link) fn len(&self) -> usize {
        self.messages.len()
    }

    /// The id of the last message that was queued.
    pub(in crate::link) const fn last_id(&self) -> Option<u64> {
        self.last_id
    }

    /// Drops all messages at the end of the link. Passes their keys to `each`.
    pub(super) fn end(&mut self, each: impl FnMut(u64)) {
        self.messages.drain(..).map(|it| it.key).for_each(each);
        self.is_full = false;
    }

    /// Checks the invariants, which hold after each call.
    pub(super) fn invariants(&self) {
        debug_assert!(self.len() <= CALLS_MAX);
    }
}
