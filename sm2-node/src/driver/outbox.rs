//! Messages that are not settled: where their bytes are, and which holders still need them.
//!
//! Each message is stored once, in every form that one of its links needs, under a key. Its holders
//! are each link until that link has settled the message, the latched store, and the call that
//! publishes the message. When the last holder releases the message, its slot is free for the next
//! message.
//!
//! If a link *ended* with a message, the slot of the message is not written again: the process at
//! the other end may be alive and may still read the slot. SM2-OPN-007 settles such messages in the
//! counters, but a reader may still use them. The slot is abandoned, and its memory returns to the
//! system when the last reader unmaps it.

mod ring;

use std::collections::BTreeMap;
use std::io;
use std::os::fd::{AsFd, BorrowedFd, OwnedFd};
use std::time::Duration;

use bytes::Bytes;
use sm2_io::{Segment, SegmentFd, Slot, memfd};
use sm2_proto::Instant;
use sm2_proto::limits::SEGMENTS_MAX;
use sm2_proto::link::{self, Fate, Placement, SegmentInfo, Status};

use self::messages::Messages;
use super::message_key::MessageKey;
use crate::pool::{Full, Geometry, Lease, Pool};

mod messages;

/// The bytes of one message, in one form or more.
#[derive(Debug, Default)]
pub(crate) struct Forms {
    pub(crate) inline: Option<Bytes>,
    pub(crate) pooled: Option<Lease<Slot>>,
    pub(crate) sealed: Option<OwnedFd>,
}

impl Forms {
    /// Whether there is no message, because no link needs it.
    pub(crate) const fn is_empty(&self) -> bool {
        self.inline.is_none() && self.pooled.is_none() && self.sealed.is_none()
    }
}

/// The forms in which the links of an interface accept messages.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct Needs {
    /// Some links accept messages only in slots, however short they are.
    pub(crate) slot: bool,
    /// Some links accept short messages inline and others in slots.
    pub(crate) pooled: bool,
    /// Some links accept short messages inline and others in files of their own.
    pub(crate) sealed: bool,
}

impl From<Placement> for Needs {
    fn from(placement: Placement) -> Self {
        Self {
            slot: placement == Placement::Slot,
            pooled: placement == Placement::InlineOrSlot,
            sealed: placement == Placement::InlineOrSealed,
        }
    }
}

impl Needs {
    /// The needs of a link whose lane is not known yet. If the link turns out to accept only slots,
    /// the message is copied to a slot later.
    pub(crate) const fn of(sealed: bool) -> Self {
        Self {
            slot: false,
            pooled: !sealed,
            sealed,
        }
    }

    pub(crate) const fn nobody(self) -> bool {
        !self.slot && !self.pooled && !self.sealed
    }

    /// Whether some links take a short message inline.
    pub(crate) const fn inline(self) -> bool {
        self.pooled || self.sealed
    }

    /// Adds the needs of another link.
    pub(crate) const fn add(&mut self, other: Self) {
        self.slot |= other.slot;
        self.pooled |= other.pooled;
        self.sealed |= other.sealed;
    }
}

/// The fields of a message's header.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Label {
    pub(crate) id: u64,
    pub(crate) time: Instant,
    pub(crate) len: u64,
}

#[derive(Debug)]
pub(crate) struct Outbox {
    pool: Pool<Slot>,
    segments: BTreeMap<u32, SegmentFd>,
    messages: Messages,
    /// How the memory of reserved segments is prepared.
    reservation: Reservation,
    /// Segments that no message uses any more and that have to be detached from all links.
    pub(super) over: Vec<u32>,
}

#[derive(Debug)]
pub(super) struct StoredMessage {
    forms: Forms,
    len: u64,
    id: u64,
    time: Instant,
    holders: u32,
    /// Whether a link ended with the message.
    orphaned: bool,
}

/// The reason why there is no slot.
#[derive(Debug)]
pub(crate) enum NoSlot {
    Full,
    Io(io::Error),
    /// The memory of the slot cannot be locked into RAM.
    Lock(io::Error),
}

/// The reason why a message cannot be put into the form that a link needs.
#[derive(Debug, thiserror::Error)]
pub(super) enum NoForm {
    /// There is no slot for the message at this moment.
    #[error("no slot: {0}")]
    Slot(io::Error),
    /// The bytes of the message cannot be copied, or no file can be created for them.
    #[error(transparent)]
    Memory(#[from] io::Error),
}

/// How the memory of a segment is prepared when the segment is reserved.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct Reservation {
    /// All pages are present.
    pub(crate) prefault: bool,
    /// All pages are locked into RAM.
    pub(crate) lock: bool,
}

impl Reservation {
    fn apply(self, segment: &mut Segment) -> Result<(), NoSlot> {
        if self.prefault {
            segment.prefault().map_err(NoSlot::Io)?;
        }
        if self.lock {
            segment.lock().map_err(NoSlot::Lock)?;
        }
        Ok(())
    }
}

/// Reserved memory for `slots` messages of up to `len` bytes each.
#[derive(Debug)]
pub(crate) struct Reserved {
    segment: Segment,
    len: u64,
    slots: u32,
    how: Reservation,
}

impl Reserved {
    pub(crate) fn new(len: u64, slots: u32, how: Reservation) -> Result<Self, NoSlot> {
        let plan = Pool::<Slot>::new(0).plan_reserved(len, slots);
        let geometry = plan.map_err(|Full| NoSlot::Full)?;
        let mut segment = Segment::create(geometry.stride, geometry.slots).map_err(NoSlot::Io)?;
        how.apply(&mut segment)?;
        Ok(Self {
            segment,
            len,
            slots,
            how,
        })
    }

    pub(crate) const fn bytes(&self) -> u64 {
        self.segment.len_bytes() as u64
    }
}

impl Outbox {
    pub(super) fn new(limit_bytes: u64) -> Self {
        Self {
            pool: Pool::new(limit_bytes),
            segments: BTreeMap::new(),
            messages: Messages::default(),
            reservation: Reservation::default(),
            over: Vec::new(),
        }
    }

    /// Sets how long segments without messages are kept.
    pub(crate) const fn keep_idle(&mut self, idle: Duration) {
        self.pool.keep_idle(idle);
    }

    /// Adds memory that was reserved before any message was sent. Also allocates table entries for
    /// twice as many messages, so that storing a message does not allocate.
    pub(crate) fn adopt(&mut self, reserved: Reserved) {
        let Reserved {
            segment,
            len,
            slots,
            how,
        } = reserved;
        let plan = self.pool.plan_reserved(len, slots);
        let geometry = plan.expect("the same was planned before");
        self.reservation = how;
        self.messages.reserve(2 * slots as usize);
        self.over.reserve(SEGMENTS_MAX);
        self.add(geometry, segment);
    }

    /// Leases a slot for `len` bytes.
    pub(crate) fn lease(&mut self, len: u64) -> Result<Lease<Slot>, NoSlot> {
        if let Some(lease) = self.ready(len) {
            return Ok(lease);
        }
        let plan = self.pool.plan(len).or_else(|Full| {
            let unused = self.pool.unused();
            self.close(unused);
            self.pool.plan(len)
        });
        let geometry = plan.map_err(|Full| NoSlot::Full)?;
        let mut segment = Segment::create(geometry.stride, geometry.slots).map_err(NoSlot::Io)?;
        if geometry.reserved {
            self.make_up_for_lost(&mut segment);
        }
        self.add(geometry, segment);
        self.pool.take(len).ok_or(NoSlot::Full)
    }

    /// Prepares a segment that replaces reserved slots, which were lost when a process died with
    /// them. Messages need new slots in any case, so a failure to prepare them is only logged.
    fn make_up_for_lost(&self, segment: &mut Segment) {
        if let Err(NoSlot::Io(error) | NoSlot::Lock(error)) = self.reservation.apply(segment) {
            tracing::warn!(%error, "memory that makes up for lost slots is neither present nor locked");
        }
    }

    fn add(&mut self, geometry: Geometry, segment: Segment) {
        let (fd, slots) = segment.split();
        self.segments.insert(geometry.id, fd);
        self.pool.add(geometry, slots);
    }

    /// Leases a slot that is free now; `None` if none is.
    pub(crate) fn ready(&mut self, len: u64) -> Option<Lease<Slot>> {
        self.pool.take(len)
    }

    /// Returns segments to the system that were not used for long. This is cheap enough to be
    /// called for every message.
    pub(crate) fn rest(&mut self, now: Instant) {
        let idle = self.pool.sweep(now);
        self.close(idle);
    }

    /// Takes back a slot that was never sent.
    pub(crate) fn unlease(&mut self, lease: Lease<Slot>) {
        let over = self.pool.give_back(lease);
        self.close(over);
    }

    /// Stores a message. The caller holds the message until it [releases](Self::release) it.
    pub(crate) fn store(&mut self, mut forms: Forms, label: Label) -> MessageKey {
        if let Some(lease) = &mut forms.pooled {
            ring::write_head(lease, label, Status::Ok);
        }
        let Label { id, time, len, .. } = label;
        self.messages.insert(StoredMessage {
            forms,
            len,
            id,
            time,
            holders: 1,
            orphaned: false,
        })
    }

    /// The fields of a message's header.
    pub(super) fn label(&self, key: MessageKey) -> Option<Label> {
        let StoredMessage { id, time, len, .. } = *self.messages.get(key)?;
        Some(Label { id, time, len })
    }

    /// Adds a holder to a message.
    pub(crate) fn hold(&mut self, key: MessageKey) {
        if let Some(message) = self.messages.get_mut(key) {
            message.holders += 1;
        }
    }

    /// Removes a holder that did not send the message.
    pub(crate) fn release(&mut self, key: MessageKey) {
        self.settle(key, Fate::Delivered);
    }

    /// Removes a holder of a message: a link has settled the message.
    pub(super) fn settle(&mut self, key: MessageKey, fate: Fate) {
        let Some(message) = self.messages.get_mut(key) else {
            return;
        };
        message.orphaned |= fate == Fate::Closed;
        message.holders -= 1;
        if message.holders > 0 {
            return;
        }
        let message = self.messages.remove(key);
        if let Some(StoredMessage {
            forms: Forms { pooled, .. },
            orphaned,
            ..
        }) = message
            && let Some(lease) = pooled
        {
            //= SM2-OPN-008
            let over = match orphaned {
                true => self.pool.abandon(lease),
                false => self.pool.give_back(lease),
            };
            self.close(over);
        }
    }

    /// The message in the form in which a link with this placement sends it. Creates that form if
    /// no other link needed it before.
    ///
    /// # Errors
    /// [`NoForm`]: the message cannot be put into that form.
    pub(super) fn message(
        &mut self,
        key: MessageKey,
        status: Status,
        placement: Placement,
    ) -> Result<link::OutboundMessage, NoForm> {
        match placement {
            Placement::Slot => self.message_in_slot(key, status),
            Placement::InlineOrSlot => Ok(self.message_or_file(key, status, false)?),
            Placement::InlineOrSealed => Ok(self.message_or_file(key, status, true)?),
        }
    }

    fn message_or_file(
        &mut self,
        key: MessageKey,
        status: Status,
        link_sealed: bool,
    ) -> io::Result<link::OutboundMessage> {
        let message = (self.messages.get_mut(key)).ok_or(io::ErrorKind::NotFound)?;
        let Forms {
            inline,
            pooled,
            sealed,
        } = &mut message.forms;
        let body = match (inline, pooled) {
            (Some(bytes), _) => link::Body::Inline(bytes.clone()),
            (None, Some(lease)) if !link_sealed => link::Body::Pooled {
                segment: info(lease),
                slot: lease.slot,
            },
            // A sealed message is legal on every link.
            (None, _) if sealed.is_some() => link::Body::Sealed,
            (None, Some(lease)) => {
                let len = usize::try_from(message.len).map_err(|_| io::ErrorKind::InvalidInput)?;
                *sealed = Some(memfd::sealed_from_bytes(lease.memory.bytes(len))?);
                link::Body::Sealed
            }
            (None, None) => return Err(io::ErrorKind::NotFound.into()),
        };
        Ok(link::OutboundMessage {
            key: key.to_raw(),
            id: message.id,
            time: message.time,
            status,
            len: message.len,
            body,
        })
    }

    /// The segment that is sent with an ATTACH.
    pub(super) fn segment(&self, attachment: link::Attachment) -> Option<SegmentFd> {
        match attachment {
            link::Attachment::Segment(id) => self.segments.get(&id).cloned(),
            link::Attachment::Ring | link::Attachment::Message(_) => None,
        }
    }

    /// The file of a sealed message.
    pub(super) fn sealed_file(&self, key: MessageKey) -> Option<BorrowedFd<'_>> {
        let forms = &self.messages.get(key)?.forms;
        Some(forms.sealed.as_ref()?.as_fd())
    }

    /// The size of all segments together, in bytes.
    pub(crate) fn pool_bytes(&self) -> u64 {
        self.pool.bytes()
    }

    fn close(&mut self, over: impl IntoIterator<Item = u32>) {
        for id in over {
            self.segments.remove(&id);
            self.over.push(id);
        }
    }
}

/// The segment of a slot, as messages refer to it.
const fn info<M>(lease: &Lease<M>) -> SegmentInfo {
    SegmentInfo {
        id: lease.segment.id,
        stride: lease.segment.stride,
        slots: lease.segment.slots,
    }
}
