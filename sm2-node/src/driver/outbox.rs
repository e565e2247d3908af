//! Messages that are not settled: where their bytes are, and which holders still need them.
//!
//! Each message is stored once, in every form that one of its links needs, under a key. Its holders
//! are each link until that link has settled the message, the latched store, and the call that
//! publishes the message. When the last holder releases the message, its slot is free for the next
//! message.
//!
//! If a link *ended* with a message, the slot of the message is not written again: the process at
//! the other end may be alive and may still read the slot. SM2-OPN-009 settles such messages in the
//! counters, but a reader may still use them. The slot is abandoned, and its memory returns to the
//! system when the last reader unmaps it.

mod forms;
mod limit;
mod message;
mod message_key;
mod messages;
mod needs;
mod pool_limit;
mod reservation;
mod slots;

use std::collections::BTreeMap;
use std::mem;

use sm2_io::{SegmentFd, Slot};
use sm2_proto::link::{Fate, Status};

pub(super) use self::forms::NoForm;
pub(super) use self::limit::Room;
pub(super) use self::message::info;
pub(crate) use self::message::{Forms, Label};
use self::message::{StoredMessage, write_head};
pub(super) use self::message_key::MessageKey;
use self::messages::Messages;
pub(crate) use self::needs::Needs;
pub(crate) use self::pool_limit::PoolLimit;
pub(crate) use self::reservation::{NoSlot, Reservation, Reserved};
use super::leftovers::Leftover;
use crate::pool::{Lease, Pool};

#[derive(Debug)]
pub(crate) struct Outbox {
    pool: Pool<Slot>,
    segments: BTreeMap<u32, SegmentFd>,
    messages: Messages,
    limit: PoolLimit,
    /// A message that would use more memory than this needs a decision which links are suspended.
    check_at: u64,
    /// How the memory of reserved segments is prepared.
    reservation: Reservation,
    /// Segments that no message uses any more and that have to be detached from all links.
    pub(super) over: Vec<u32>,
    /// Memory that goes back to the system.
    pub(super) leftovers: Vec<Leftover>,
}

impl Outbox {
    pub(super) fn new(limit: PoolLimit) -> Self {
        let bytes = limit.bytes_for(0);
        Self {
            pool: Pool::new(bytes),
            limit,
            // The first message decides.
            check_at: if bytes == u64::MAX { bytes } else { 0 },
            segments: BTreeMap::new(),
            messages: Messages::default(),
            reservation: Reservation::default(),
            over: Vec::new(),
            leftovers: Vec::new(),
        }
    }

    /// Stores a message. The caller holds the message until it [releases](Self::release) it.
    pub(crate) fn store(&mut self, mut forms: Forms, label: Label) -> MessageKey {
        let lease = forms.pooled.take();
        forms.pooled = lease.and_then(|it| self.out_of_replaced(it, label.len));
        if let Some(lease) = &mut forms.pooled {
            write_head(lease, label, Status::Ok);
        }
        self.pool.add_outside(forms.bytes_outside(label.len));
        let (key, place) = self.messages.insert(label);
        *place = forms;
        key
    }

    /// Stores a message whose payload is in this slot, which was leased under the same lock. The caller holds the
    /// message until it [releases](Self::release) it.
    #[inline]
    pub(super) fn store_in_slot(&mut self, mut lease: Lease<Slot>, label: Label) -> MessageKey {
        write_head(&mut lease, label, Status::Ok);
        let (key, forms) = self.messages.insert(label);
        forms.pooled = Some(lease);
        key
    }

    /// The fields of a message's header.
    pub(super) fn label(&self, key: MessageKey) -> Option<Label> {
        self.messages.get(key).map(|it| it.label)
    }

    /// Adds a holder to a message.
    #[inline]
    pub(crate) fn hold(&mut self, key: MessageKey) {
        if let Some(message) = self.messages.get_mut(key) {
            message.holders += 1;
        }
    }

    /// Removes a holder that did not send the message.
    #[inline]
    pub(crate) fn release(&mut self, key: MessageKey) {
        match self.messages.get_mut(key) {
            Some(message) if message.holders > 1 => message.holders -= 1,
            _ => self.remove_holder(key, false),
        }
    }

    /// Removes a holder of a message: a link has settled the message.
    pub(super) fn settle(&mut self, key: MessageKey, fate: Fate) {
        self.remove_holder(key, fate == Fate::Closed);
    }

    /// Removes a holder, and frees the memory of a message without holders.
    #[inline]
    fn remove_holder(&mut self, key: MessageKey, is_orphaned: bool) {
        let Some(message) = self.messages.remove_holder(key, is_orphaned) else {
            return;
        };
        if message.orphaned || !message.forms.are_slot_alone() {
            let message = mem::take(message);
            return self.free(message);
        }
        let lease = message.forms.pooled.take();
        if let Some(segment) = lease.and_then(|it| self.pool.give_back(it)) {
            self.close([segment]);
        }
    }

    /// Frees the memory of a message, whatever forms it has.
    #[cold]
    fn free(&mut self, mut message: StoredMessage) {
        self.pool.remove_outside(message.bytes_outside());
        // The receivers of other messages have usually closed the file before.
        let file = message.forms.sealed.take_if(|_| message.orphaned);
        self.leftovers.extend(file.map(Leftover::File));
        if let Some(lease) = message.forms.pooled {
            //= SM2-OPN-010
            let over = match message.orphaned {
                true => self.pool.abandon(lease),
                false => self.pool.give_back(lease),
            };
            self.close(over);
        }
    }

    /// The size of all segments together, in bytes.
    pub(crate) fn pool_bytes(&self) -> u64 {
        self.pool.bytes()
    }
}
