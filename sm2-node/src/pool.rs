//! Which slot of which segment is free: bookkeeping alone.
//!
//! A [`Pool`] holds what stands for the memory of free slots, without touching it, and
//! says how large the next segment is to be. It knows neither links nor messages:
//! its owner, the [outbox](crate::driver), gives a slot back when nobody needs it any more.
//!
//! - A slot's size is a power of two, 4 KiB at least. Slots of one size form a class.
//! - The slot that was given back last is taken first: its memory is still in a cache,
//!   and slots that were never needed cost no memory at all.
//! - A class that has no free slot gets a segment with as many slots as it has
//!   already. So segments are few: their number grows with the logarithm of the need.
//! - A slot can be *abandoned*: never to be written again, since somebody might still
//!   read it. Its segment then serves no further message, and is over when the last of its
//!   slots is back.

use std::collections::BTreeMap;

use sm2_proto::limits::{MESSAGE_MAX, SEGMENT_BYTES_MAX, SEGMENTS_MAX, SLOTS_MAX, STRIDE_UNIT};

#[cfg(test)]
mod tests;

/// Free slots, whose memory is an `M` each.
#[derive(Debug)]
pub(crate) struct Pool<M> {
    segments: BTreeMap<u32, Segment>,
    /// By size of the slot. The end of each list is taken first.
    free: BTreeMap<u64, Vec<Lease<M>>>,
    next_id: u32,
    limit_bytes: u64,
}

/// A slot that is in use: the right to its memory.
#[derive(Debug)]
pub(crate) struct Lease<M> {
    pub(crate) segment: Geometry,
    pub(crate) slot: u32,
    pub(crate) memory: M,
}

/// A segment's number and form.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Geometry {
    pub(crate) id: u32,
    pub(crate) stride: u64,
    pub(crate) slots: u32,
}

/// There is no room for one more slot of this size.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Full;

#[derive(Debug)]
struct Segment {
    geometry: Geometry,
    free: u32,
    /// Slots that never come back; more than zero ends the segment.
    gone: u32,
    retired: bool,
}

impl Geometry {
    const fn bytes(self) -> u64 {
        self.stride * self.slots as u64
    }
}

impl<M> Pool<M> {
    /// An empty pool, which grows to at most `limit_bytes`.
    pub(crate) const fn new(limit_bytes: u64) -> Self {
        Self {
            segments: BTreeMap::new(),
            free: BTreeMap::new(),
            next_id: 0,
            limit_bytes,
        }
    }

    /// A free slot for `len` bytes.
    pub(crate) fn take(&mut self, len: u64) -> Option<Lease<M>> {
        let lease = self.free.get_mut(&stride_for(len))?.pop()?;
        self.segment_mut(lease.segment.id).free -= 1;
        self.check_invariants();
        Some(lease)
    }

    /// The segment to [add](Self::add), so that `len` bytes find a slot.
    ///
    /// # Errors
    ///
    /// [`Full`]: the limit leaves no room, even if [idle](Self::idle) segments go.
    pub(crate) fn plan(&self, len: u64) -> Result<Geometry, Full> {
        if len > MESSAGE_MAX || self.segments.len() >= SEGMENTS_MAX {
            return Err(Full);
        }
        let stride = stride_for(len);
        let has: u32 = (self.segments.values())
            .filter(|segment| segment.geometry.stride == stride && !segment.retired)
            .map(|segment| segment.geometry.slots)
            .sum();
        let room = self.limit_bytes.saturating_sub(self.bytes());
        let most = room.min(SEGMENT_BYTES_MAX) / stride;
        let wanted = u64::from(has.max(first_slots(stride)).min(SLOTS_MAX));
        match u32::try_from(wanted.min(most)) {
            Ok(0) | Err(_) => Err(Full),
            Ok(slots) => Ok(Geometry {
                id: self.unused_id(),
                stride,
                slots,
            }),
        }
    }

    /// Adds a segment as [planned](Self::plan); `memory` is that of its slots, in order.
    pub(crate) fn add(&mut self, geometry: Geometry, memory: impl IntoIterator<Item = M>) {
        self.next_id = geometry.id.wrapping_add(1);
        let mut leases: Vec<_> = (0..geometry.slots)
            .zip(memory)
            .map(|(slot, memory)| Lease {
                segment: geometry,
                slot,
                memory,
            })
            .collect();
        debug_assert_eq!(leases.len(), geometry.slots as usize);
        // The first slot is taken first, and all of them only when older ones are in use.
        leases.reverse();
        let class = self.free.entry(geometry.stride).or_default();
        leases.append(class);
        *class = leases;
        self.segments.insert(
            geometry.id,
            Segment {
                geometry,
                free: geometry.slots,
                gone: 0,
                retired: false,
            },
        );
        self.check_invariants();
    }

    /// Takes back a slot that nobody reads any more. The number of its segment, if that is over.
    pub(crate) fn give_back(&mut self, lease: Lease<M>) -> Option<u32> {
        let id = lease.segment.id;
        let segment = self.segment_mut(id);
        if segment.retired {
            return self.lose(id);
        }
        segment.free += 1;
        let class = self.free.entry(lease.segment.stride).or_default();
        class.push(lease);
        self.check_invariants();
        None
    }

    /// Gives up a slot that must not be written again, and its segment with it. The
    /// segment's number, if it is over.
    pub(crate) fn abandon(&mut self, lease: Lease<M>) -> Option<u32> {
        let id = lease.segment.id;
        self.retire(id);
        self.lose(id)
    }

    /// Gives up all segments of which every slot is free; their numbers.
    pub(crate) fn idle(&mut self) -> Vec<u32> {
        let idle: Vec<u32> = (self.segments.values())
            .filter(|segment| segment.free == segment.geometry.slots)
            .map(|segment| segment.geometry.id)
            .collect();
        for &id in &idle {
            self.retire(id);
            self.segments.remove(&id);
        }
        self.check_invariants();
        idle
    }

    /// The size of all segments together.
    pub(crate) fn bytes(&self) -> u64 {
        (self.segments.values())
            .map(|segment| segment.geometry.bytes())
            .sum()
    }

    /// No slot of this segment is handed out any more.
    fn retire(&mut self, id: u32) {
        let segment = self.segment_mut(id);
        segment.retired = true;
        segment.gone += segment.free;
        segment.free = 0;
        let stride = segment.geometry.stride;
        if let Some(class) = self.free.get_mut(&stride) {
            class.retain(|lease| lease.segment.id != id);
        }
    }

    /// One slot of a retired segment is back.
    fn lose(&mut self, id: u32) -> Option<u32> {
        let segment = self.segment_mut(id);
        segment.gone += 1;
        let over = segment.gone == segment.geometry.slots;
        if over {
            self.segments.remove(&id);
        }
        self.check_invariants();
        over.then_some(id)
    }

    fn segment_mut(&mut self, id: u32) -> &mut Segment {
        (self.segments.get_mut(&id)).expect("a lease's segment lives until its last slot is back")
    }

    fn unused_id(&self) -> u32 {
        let mut id = self.next_id;
        while self.segments.contains_key(&id) {
            id = id.wrapping_add(1);
        }
        id
    }

    fn check_invariants(&self) {
        if cfg!(debug_assertions) {
            for segment in self.segments.values() {
                let Geometry { id, stride, slots } = segment.geometry;
                let listed = (self.free.get(&stride).into_iter().flatten())
                    .filter(|lease| lease.segment.id == id)
                    .count();
                assert_eq!(listed, segment.free as usize);
                assert!(segment.free + segment.gone <= slots);
                assert_eq!(segment.retired, segment.gone > 0);
            }
            assert!(self.segments.len() <= SEGMENTS_MAX);
            assert!(self.bytes() <= self.limit_bytes);
        }
    }
}

/// The size of the slot for a message of `len` bytes.
pub(crate) const fn stride_for(len: u64) -> u64 {
    let least = if len > STRIDE_UNIT { len } else { STRIDE_UNIT };
    least.next_power_of_two()
}

/// How many slots the first segment of a class has.
const fn first_slots(stride: u64) -> u32 {
    match stride {
        0..=0x1_0000 => 16,
        0x1_0001..=0x10_0000 => 4,
        _ => 1,
    }
}
