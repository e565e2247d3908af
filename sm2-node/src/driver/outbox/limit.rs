//! The limit of the memory for messages, and how much of it is in use.
//!
//! Messages that suspended links still hold take a part of the limit. Of the rest, active links may hold at most half,
//! and all of the reserved memory; the other half is for subscribers that release what they get. If the messages of
//! active links exceed this bound, the publisher suspends the subscriber that has kept its samples longest
//! (SM2-QOS-007). A limit that only stopped the last allocation would take the memory from all subscribers.
//!
//! A decision visits every message in flight. It is due only when the use of memory has grown to a mark that the last
//! decision set, so a message costs one comparison.

use super::Outbox;
use super::message::{Forms, StoredMessage};
use super::message_key::MessageKey;

/// The memory that active links can use: what the limit leaves beside the messages that suspended links and the
/// publisher itself hold.
#[derive(Clone, Copy, Debug)]
pub(in crate::driver) struct Room {
    /// The memory of messages that active links hold.
    pub(in crate::driver) held: u64,
    /// The memory that these messages and new ones can use.
    capacity: u64,
    /// The memory that counts against the limit.
    limit: u64,
}

impl Room {
    /// How much of the capacity active links may hold. The rest is for the messages of links that
    /// release what they get.
    pub(in crate::driver) fn bound(&self) -> u64 {
        self.capacity - self.limit.min(self.capacity) / 2
    }

    /// The room with a link that holds at most this much and stays active.
    pub(in crate::driver) const fn with(self, bytes: u64) -> Self {
        Self {
            held: self.held.saturating_add(bytes),
            capacity: self.capacity.saturating_add(bytes),
            ..self
        }
    }

    /// The room after a link is suspended that alone holds this much.
    pub(in crate::driver) const fn without(self, bytes: u64) -> Self {
        Self {
            held: self.held.saturating_sub(bytes),
            capacity: self.capacity.saturating_sub(bytes),
            ..self
        }
    }
}

impl Outbox {
    /// Raises the limit to what messages of this length need.
    pub(super) const fn raise_limit(&mut self, len: u64) {
        self.pool.raise_limit(self.limit.bytes_for(len));
    }

    /// Whether a message of this length needs a decision which links are suspended.
    #[inline]
    pub(crate) const fn is_check_due(&self, len: u64) -> bool {
        self.pool.used().saturating_add(len) > self.check_at
    }

    /// Makes the next message decide which links are suspended.
    pub(in crate::driver) const fn recheck(&mut self) {
        self.check_at = 0;
    }

    /// The room for a message of this length, if active links hold `held` bytes.
    pub(in crate::driver) fn room(&mut self, len: u64, held: u64) -> Room {
        self.raise_limit(len);
        let limit = self.pool.limit_bytes();
        let others = self.pool.used().saturating_sub(held);
        let all = limit.saturating_add(self.pool.reserved_bytes());
        Room {
            held,
            capacity: all.saturating_sub(others),
            limit,
        }
    }

    /// Sets the use of memory that makes the next decision due.
    pub(in crate::driver) fn check_from(&mut self, room: Room) {
        let more = room.bound().saturating_sub(room.held);
        self.check_at = self.pool.used().saturating_add(more);
    }

    /// The limit and the reserved memory together, in bytes.
    pub(crate) const fn pool_limit_bytes(&self) -> u64 {
        self.pool
            .limit_bytes()
            .saturating_add(self.pool.reserved_bytes())
    }

    /// Whether a file of this length for a message is within the limit. Frees unused segments if
    /// that makes room.
    pub(crate) fn has_room_for_file(&mut self, len: u64) -> bool {
        self.raise_limit(len);
        if !self.pool.has_room_outside(len) {
            let unused = self.pool.unused();
            self.close(unused);
        }
        self.pool.has_room_outside(len)
    }

    /// The number and the memory of a stored message.
    pub(in crate::driver) fn footprint(&self, key: MessageKey) -> Option<(u64, u64)> {
        let message = self.messages.get(key)?;
        Some((message.label.id, message.bytes()))
    }
}

impl Forms {
    /// The memory of a message of `len` bytes outside of segments.
    pub(super) fn bytes_outside(&self, len: u64) -> u64 {
        let inline = self.inline.as_ref().map_or(0, |it| it.len() as u64);
        inline + if self.sealed.is_some() { len } else { 0 }
    }
}

impl StoredMessage {
    /// The memory of the message outside of segments.
    pub(super) fn bytes_outside(&self) -> u64 {
        self.forms.bytes_outside(self.label.len)
    }

    /// The memory of the message.
    pub(super) fn bytes(&self) -> u64 {
        let slot = self.forms.pooled.as_ref().map_or(0, |it| it.segment.stride);
        slot + self.bytes_outside()
    }
}
