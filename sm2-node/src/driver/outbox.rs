//! Messages on their way out: where their bytes are, and who still needs them.
//!
//! Each message is stored once, in every form that one of its links needs, and is
//! named by a key. It is held by each link until that link has settled it, by the
//! latched store, and by the call that publishes it. When the last of them lets go,
//! its slot is free for the next message.
//!
//! A slot is not written again if a link *ended* with it: the process at its other
//! end may be alive and may still read it (SM2-OPN-007 settles the accounts, it does not
//! take a message out of a reader's hands). Such a slot is abandoned, and the memory
//! goes back to the system when its last reader unmaps it.

use std::collections::{BTreeMap, HashMap};
use std::io;
use std::os::fd::{AsFd, BorrowedFd, OwnedFd};

use bytes::Bytes;
use sm2_io::{Segment, SegmentFd, Slot, memfd};
use sm2_proto::Instant;
use sm2_proto::link::{self, Fate, SegmentInfo, Status};

use crate::pool::{Full, Lease, Pool};

/// The bytes of one message, in one form or more.
#[derive(Debug, Default)]
pub(crate) struct Forms {
    pub(crate) inline: Option<Bytes>,
    pub(crate) pooled: Option<Lease<Slot>>,
    pub(crate) sealed: Option<OwnedFd>,
}

impl Forms {
    /// Whether there is no message, since nobody needs it.
    pub(crate) const fn is_empty(&self) -> bool {
        self.inline.is_none() && self.pooled.is_none() && self.sealed.is_none()
    }
}

/// Which forms the links of an interface need for a message that is not inline.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct Needs {
    pub(crate) pooled: bool,
    pub(crate) sealed: bool,
}

impl Needs {
    /// What one link needs.
    pub(crate) const fn of(sealed: bool) -> Self {
        Self {
            pooled: !sealed,
            sealed,
        }
    }

    pub(crate) const fn nobody(self) -> bool {
        !self.pooled && !self.sealed
    }

    pub(crate) const fn add(&mut self, sealed: bool) {
        if sealed {
            self.sealed = true;
        } else {
            self.pooled = true;
        }
    }
}

/// What stands in the header of a message.
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
    messages: HashMap<u64, Message>,
    last_key: u64,
    /// Segments that no message uses any more, to be detached from all links.
    pub(super) over: Vec<u32>,
}

#[derive(Debug)]
struct Message {
    forms: Forms,
    len: u64,
    id: u64,
    time: Instant,
    holders: u32,
    /// Whether a link ended with it.
    orphaned: bool,
}

/// Why there is no slot.
#[derive(Debug)]
pub(crate) enum NoSlot {
    Full,
    Io(io::Error),
}

impl Outbox {
    pub(super) fn new(limit_bytes: u64) -> Self {
        Self {
            pool: Pool::new(limit_bytes),
            segments: BTreeMap::new(),
            messages: HashMap::new(),
            last_key: 0,
            over: Vec::new(),
        }
    }

    /// A slot for `len` bytes.
    pub(crate) fn lease(&mut self, len: u64) -> Result<Lease<Slot>, NoSlot> {
        if let Some(lease) = self.pool.take(len) {
            return Ok(lease);
        }
        let plan = self.pool.plan(len).or_else(|Full| {
            let idle = self.pool.idle();
            self.close(idle);
            self.pool.plan(len)
        });
        let geometry = plan.map_err(|Full| NoSlot::Full)?;
        let segment = Segment::create(geometry.stride, geometry.slots).map_err(NoSlot::Io)?;
        let (fd, slots) = segment.split();
        self.segments.insert(geometry.id, fd);
        self.pool.add(geometry, slots);
        self.pool.take(len).ok_or(NoSlot::Full)
    }

    /// Takes back a slot that was never sent.
    pub(crate) fn unlease(&mut self, lease: Lease<Slot>) {
        let over = self.pool.give_back(lease);
        self.close(over);
    }

    /// Stores a message. The caller holds it, until it [lets go](Self::release).
    pub(crate) fn store(&mut self, forms: Forms, label: Label) -> u64 {
        self.last_key += 1;
        let Label { id, time, len, .. } = label;
        let message = Message {
            forms,
            len,
            id,
            time,
            holders: 1,
            orphaned: false,
        };
        self.messages.insert(self.last_key, message);
        self.last_key
    }

    /// One more holder.
    pub(crate) fn hold(&mut self, key: u64) {
        if let Some(message) = self.messages.get_mut(&key) {
            message.holders += 1;
        }
    }

    /// One holder less, who did not give it to anybody.
    pub(crate) fn release(&mut self, key: u64) {
        self.settle(key, Fate::Delivered);
    }

    /// A link is done with a message.
    pub(super) fn settle(&mut self, key: u64, fate: Fate) {
        let Some(message) = self.messages.get_mut(&key) else {
            return;
        };
        message.orphaned |= fate == Fate::Closed;
        message.holders -= 1;
        if message.holders > 0 {
            return;
        }
        let message = self.messages.remove(&key);
        if let Some(Message {
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

    /// The message as a link sends it; it makes the form that this link needs, if nobody
    /// needed it up to now.
    pub(super) fn message(
        &mut self,
        key: u64,
        status: Status,
        link_sealed: bool,
    ) -> io::Result<link::Message> {
        let message = (self.messages.get_mut(&key)).ok_or(io::ErrorKind::NotFound)?;
        let Forms {
            inline,
            pooled,
            sealed,
        } = &mut message.forms;
        let body = match (inline, pooled) {
            (Some(bytes), _) => link::Body::Inline(bytes.clone()),
            (None, Some(lease)) if !link_sealed => link::Body::Pooled {
                segment: SegmentInfo {
                    id: lease.segment.id,
                    stride: lease.segment.stride,
                    slots: lease.segment.slots,
                },
                slot: lease.slot,
            },
            // A sealed message is legal on every link.
            (None, _) if sealed.is_some() => link::Body::Sealed,
            (None, Some(lease)) => {
                let len = usize::try_from(message.len).map_err(|_| io::ErrorKind::InvalidInput)?;
                *sealed = Some(seal(lease.memory.bytes(len))?);
                link::Body::Sealed
            }
            (None, None) => return Err(io::ErrorKind::NotFound.into()),
        };
        Ok(link::Message {
            key,
            id: message.id,
            time: message.time,
            status,
            len: message.len,
            body,
        })
    }

    /// The descriptor that goes with a packet.
    pub(super) fn descriptor(&self, attachment: link::Attachment) -> Option<BorrowedFd<'_>> {
        match attachment {
            link::Attachment::Segment(id) => Some(self.segments.get(&id)?.as_fd()),
            link::Attachment::Message(key) => {
                Some(self.messages.get(&key)?.forms.sealed.as_ref()?.as_fd())
            }
        }
    }

    /// The size of all segments together.
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

/// A sealed file with a copy of `bytes`, made in the way that is fastest here.
pub(crate) fn seal(bytes: &[u8]) -> io::Result<OwnedFd> {
    /// What one huge page holds: a smaller file cannot use any.
    const HUGE_PAGE: usize = 2 << 20;
    if bytes.len() >= HUGE_PAGE && memfd::huge_pages_allowed() {
        let mut loan = memfd::SealedLoan::new(bytes.len() as u64)?;
        loan.as_mut_slice().copy_from_slice(bytes);
        return loan.seal();
    }
    memfd::sealed_from_bytes(bytes)
}
