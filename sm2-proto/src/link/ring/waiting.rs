//! Messages of a caller or server that wait for room in a ring.
//!
//! No call and no reply is refused for want of room: a message that the ring does not take waits
//! here, in its order. The limit of calls bounds how many can wait.

use alloc::collections::VecDeque;

use super::{super::Misuse, message::RingMessage};
use crate::{
    limits::{CALLS_MAX, MESSAGE_MAX, RING_SEGMENTS_MAX, SLOT_HEAD},
    link::segments::Geometry,
};

/// Messages that wait for room in a ring, the oldest first.
#[derive(Clone, Debug, Default, PartialEq, Eq, Hash)]
pub(in crate::link) struct Waiting {
    messages: VecDeque<RingMessage>,
    /// The id of the last message that was ever here.
    last_id: Option<u64>,
    /// Whether the ring had no room for the first of them, when that was last seen.
    pub(in crate::link) is_full: bool,
}

impl Waiting {
    /// Whether a message may be put here, by properties that do not change until it is sent.
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

    pub(in crate::link) fn push(&mut self, message: RingMessage) {
        self.last_id = Some(message.id);
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

    /// The id of the last message that was ever here.
    pub(in crate::link) const fn last_id(&self) -> Option<u64> {
        self.last_id
    }

    /// The link is over. Passes the keys to `each`.
    pub(super) fn end(&mut self, each: impl FnMut(u64)) {
        self.messages.drain(..).map(|it| it.key).for_each(each);
        self.is_full = false;
    }

    /// Checks what must hold between any two calls.
    pub(super) fn invariants(&self) {
        debug_assert!(self.len() <= CALLS_MAX);
    }
}
