//! The slots and segments of an outbox.

use std::time::Duration;

use sm2_io::{Segment, SegmentFd, Slot};
use sm2_proto::Instant;
use sm2_proto::limits::SEGMENTS_MAX;
use sm2_proto::link;

use super::Outbox;
use super::reservation::{NoSlot, Reserved};
use crate::driver::leftovers::Leftover;
use crate::pool::{Full, Geometry, Lease};

impl Outbox {
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
        self.leftovers.reserve(SEGMENTS_MAX);
        self.add(geometry, segment);
    }

    /// Leases a slot for `len` bytes.
    pub(crate) fn lease(&mut self, len: u64) -> Result<Lease<Slot>, NoSlot> {
        if let Some(lease) = self.pool.take(len, |_| ()) {
            return Ok(lease);
        }
        self.raise_limit(len);
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
        self.pool.take(len, |_| ()).ok_or(NoSlot::Full)
    }

    /// Prepares a segment that replaces reserved slots, which were lost when a process died with
    /// them. Messages need new slots in any case, so a failure to prepare them is only logged.
    fn make_up_for_lost(&self, segment: &mut Segment) {
        if let Err(NoSlot::Io(error) | NoSlot::Lock(error)) = self.reservation.apply(segment) {
            tracing::warn!(%error, "cannot prefault or lock the memory that replaces lost slots");
        }
    }

    fn add(&mut self, geometry: Geometry, segment: Segment) {
        let (fd, slots) = segment.split();
        self.segments.insert(geometry.id, fd);
        self.pool.add(geometry, slots);
    }

    /// Leases a slot that is free now; `None` if none is, or if [`suspended
    /// links`](Outbox::is_check_due) have to be decided first.
    #[inline]
    pub(crate) fn lease_free(&mut self, len: u64) -> Option<Lease<Slot>> {
        if self.is_check_due(len) {
            return None;
        }
        // The next message will probably have about the same length.
        self.pool.take(len, Slot::prefetch_to_write)
    }

    /// Returns segments to the system that were not used for long. This is cheap enough to be
    /// called for every message.
    #[inline]
    pub(crate) fn free_idle(&mut self, now: Instant) {
        if self.pool.is_sweep_due(now) {
            let idle = self.pool.sweep(now);
            self.close(idle);
        }
    }

    /// Lets all further messages go to new segments: a process that the access policy has cut off may map those that
    /// exist.
    //= SM2-ACC-015
    pub(crate) fn replace_segments(&mut self) {
        let over = self.pool.replace_all();
        self.close(over);
    }

    /// Moves a message of `len` bytes out of a slot whose segment was replaced after the slot was leased. Returns
    /// `None` if there is no slot for it.
    pub(super) fn out_of_replaced(&mut self, lease: Lease<Slot>, len: u64) -> Option<Lease<Slot>> {
        if !self.pool.is_replaced(&lease) {
            return Some(lease);
        }
        let moved = self.lease(len).ok().map(|mut moved| {
            // Both leases are for this length, so the range is inside the slots.
            let len = len as usize;
            moved
                .memory
                .bytes_mut(len)
                .copy_from_slice(lease.memory.bytes(len));
            moved
        });
        self.unlease(lease);
        moved
    }

    /// Takes back a slot that was never sent.
    pub(crate) fn unlease(&mut self, lease: Lease<Slot>) {
        let over = self.pool.give_back(lease);
        self.close(over);
    }

    /// The segment that is sent with an ATTACH.
    pub(in crate::driver) fn segment(&self, attachment: link::Attachment) -> Option<SegmentFd> {
        match attachment {
            link::Attachment::Segment(id) => self.segments.get(&id).cloned(),
            link::Attachment::Ring | link::Attachment::Message(_) => None,
        }
    }

    pub(super) fn close(&mut self, over: impl IntoIterator<Item = u32>) {
        for id in over {
            let segment = self.segments.remove(&id);
            self.leftovers.extend(segment.map(Leftover::Segment));
            self.over.push(id);
        }
    }
}
