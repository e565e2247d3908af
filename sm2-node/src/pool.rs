//! Bookkeeping of free slots in segments.
//!
//! A [`Pool`] holds the handles of free slots and decides how large the next segment is. It does not access
//! the memory, and knows neither links nor messages: its owner, the [outbox](crate::driver), gives a slot
//! back when no link needs it any more.
//!
//! - Slot sizes are powers of two, and the sizes halfway between two of them: at least 128 bytes, multiples
//!   of 64 below a page, of 4 KiB from there on, and of 2 MiB for large slots, so that each large slot begins
//!   with a huge page. Slots of one size form a class. The last
//!   [`HEAD_BYTES`](sizes::HEAD_BYTES) of a slot are reserved for the message's head.
//! - Within a class, a slot of the oldest segment is taken, and there the slot that was given back last,
//!   whose memory is probably still in a cache. Slots that were never needed occupy no memory, and younger
//!   segments fall idle after a burst. If the class has no free slot, a slot of up to twice the size is used,
//!   so that messages of varying length do not need memory for each length.
//! - A class without a free slot gets a segment with as many slots as the class already has, but of at most 32 MiB
//!   unless one slot is longer. The number of segments therefore grows with the logarithm of the need at first. The
//!   system takes back a segment in one piece, so its size bounds how long that takes.
//! - A segment without a slot in use for some time is [freed](Pool::sweep). Only whole segments can be freed:
//!   their seals forbid holes.
//! - A slot can be *abandoned*: it must never be written again, because a receiver may still read it. Its
//!   segment then serves no further message, and is freed when its last slot is back.
//! - All segments can be [replaced](Pool::replace_all): a process that the access policy has cut off may still map
//!   them. They serve no further message, not even one whose slot is already leased. Reserved slots are made up for.
//! - A segment can be *reserved*: it exists from the beginning, does not count against the limit, serves
//!   messages of any length that fits, and is never freed for being idle. If one of its slots is abandoned,
//!   only that slot is lost; it is replaced when it is needed.

use std::time::Duration;

use sm2_proto::Instant;
use sm2_proto::limits::{MESSAGE_MAX, SEGMENT_BYTES_MAX, SEGMENTS_MAX, SLOTS_MAX};

#[cfg(test)]
mod replaced_tests;
mod sizes;
#[cfg(test)]
mod tests;

pub(crate) use self::sizes::stride_for;
use self::sizes::{SEGMENT_BYTES, first_slots};

/// The default of [`PublisherBuilder::pool_limit`](crate::PublisherBuilder::pool_limit), in bytes: 256 MiB.
pub const POOL_LIMIT_BYTES: u64 = 256 << 20;

/// The least number of messages that the default of
/// [`PublisherBuilder::pool_limit`](crate::PublisherBuilder::pool_limit) allows. Half of them are as many as
/// one subscriber with the default options may have in flight.
pub const POOL_LIMIT_MESSAGES: u64 = 24;

/// How long an idle segment is kept, unless a builder sets another time.
pub(crate) const IDLE_DEFAULT: Duration = Duration::from_secs(5);

/// The upper bound of segment numbers, which have 15 bits (SM2-RNG-003).
const IDS: u32 = 1 << 15;

/// Free slots. Each has a handle of type `M` to its memory.
#[derive(Debug)]
pub(crate) struct Pool<M> {
    /// Sorted by slot size, then by age, the oldest first. A few segments, 256 at most.
    segments: Vec<PoolSegment<M>>,
    next_id: u32,
    limit_bytes: u64,
    /// The total size of all segments, reserved ones included.
    bytes: u64,
    reserved_bytes: u64,
    /// The total size of the slots in use, and of messages outside of segments.
    used: u64,
    /// The size of messages outside of segments, which count against the limit.
    outside: u64,
    /// Slots of reserved segments that are lost.
    lost: Lost,
    /// Number of segments that were replaced and still have slots in use.
    replaced: usize,
    idle: Duration,
    swept: Instant,
}

/// A slot in use, with the handle to its memory.
#[derive(Debug)]
pub(crate) struct Lease<M> {
    pub(crate) segment: Geometry,
    pub(crate) slot: u32,
    pub(crate) memory: M,
}

/// The number and the layout of a segment.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Geometry {
    pub(crate) id: u32,
    pub(crate) stride: u64,
    pub(crate) slots: u32,
    /// Whether the segment does not count against the limit and is never freed for being idle.
    pub(crate) reserved: bool,
}

/// The limit leaves no room for one more slot of this size.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Full;

#[derive(Debug)]
struct PoolSegment<M> {
    geometry: Geometry,
    /// Used as a stack.
    free: Vec<Lease<M>>,
    /// Number of slots that will never come back.
    gone: u32,
    retired: bool,
    /// Whether a process that must not read further messages may map the segment. It is retired then.
    replaced: bool,
    /// Whether a slot was taken or given back since the last sweep.
    touched: bool,
}

/// The size and the number of lost slots to replace.
#[derive(Clone, Copy, Debug, Default)]
struct Lost {
    stride: u64,
    slots: u32,
}

impl Geometry {
    const fn bytes(self) -> u64 {
        self.stride * self.slots as u64
    }
}

impl<M> PoolSegment<M> {
    fn is_unused(&self) -> bool {
        self.free.len() == self.geometry.slots as usize
    }
}

impl<M> Pool<M> {
    /// Creates an empty pool that can grow to `limit_bytes`.
    pub(crate) const fn new(limit_bytes: u64) -> Self {
        Self {
            segments: Vec::new(),
            next_id: 0,
            limit_bytes,
            bytes: 0,
            reserved_bytes: 0,
            used: 0,
            outside: 0,
            lost: Lost {
                stride: 0,
                slots: 0,
            },
            replaced: 0,
            idle: IDLE_DEFAULT,
            swept: Instant(0),
        }
    }

    /// Sets how long idle segments are kept.
    pub(crate) const fn keep_idle(&mut self, idle: Duration) {
        self.idle = idle;
    }

    /// Takes a free slot for `len` bytes and a head. Passes the one that the next call takes, if it is known, to
    /// `announce`.
    #[inline]
    pub(crate) fn take(&mut self, len: u64, announce: impl FnOnce(&M)) -> Option<Lease<M>> {
        let stride = stride_for(len);
        let fits = |it: &PoolSegment<M>| it.geometry.stride <= 2 * stride || it.geometry.reserved;
        let mut larger = (self.segments.iter_mut()).skip_while(|it| it.geometry.stride < stride);
        let segment = larger.find(|it| fits(it) && !it.free.is_empty())?;
        segment.touched = true;
        let lease = segment.free.pop()?;
        if let Some(next) = segment.free.last() {
            announce(&next.memory);
        }
        self.used += lease.segment.stride;
        self.check_invariants();
        Some(lease)
    }

    /// Returns the segment to [add](Self::add) so that there is a slot for `len` bytes.
    ///
    /// # Errors
    ///
    /// [`Full`] if the limit leaves no room, even after freeing [unused](Self::unused) segments.
    pub(crate) fn plan(&self, len: u64) -> Result<Geometry, Full> {
        if len > MESSAGE_MAX || self.segments.len() >= SEGMENTS_MAX {
            return Err(Full);
        }
        let stride = stride_for(len);
        if self.lost.slots > 0 && self.lost.stride >= stride {
            let Lost { stride, slots } = self.lost;
            return Ok(self.geometry(stride, slots, true));
        }
        let has: u32 = (self.segments.iter())
            .filter(|it| it.geometry.stride == stride && !it.retired && !it.geometry.reserved)
            .map(|it| it.geometry.slots)
            .sum();
        let most = self.free_bytes().min(SEGMENT_BYTES_MAX) / stride;
        let wanted = u64::from(has.max(first_slots(stride)).min(SLOTS_MAX));
        // A pool with very many segments may need larger ones to use its limit.
        let wanted = match self.segments.len() < SEGMENTS_MAX / 2 {
            true => wanted.min((SEGMENT_BYTES / stride).max(1)),
            false => wanted,
        };
        match u32::try_from(wanted.min(most)) {
            Ok(0) | Err(_) => Err(Full),
            Ok(slots) => Ok(self.geometry(stride, slots, false)),
        }
    }

    /// Returns the segment to [add](Self::add) so that `slots` slots for `len` bytes are reserved.
    ///
    /// # Errors
    ///
    /// [`Full`] if no segment can be so large.
    pub(crate) fn plan_reserved(&self, len: u64, slots: u32) -> Result<Geometry, Full> {
        if len > MESSAGE_MAX || slots > SLOTS_MAX || self.segments.len() >= SEGMENTS_MAX {
            return Err(Full);
        }
        let stride = stride_for(len);
        if u64::from(slots) > SEGMENT_BYTES_MAX / stride {
            return Err(Full);
        }
        Ok(self.geometry(stride, slots, true))
    }

    fn geometry(&self, stride: u64, slots: u32, reserved: bool) -> Geometry {
        // A number is reused as late as possible.
        let is_used = |id: &u32| self.segments.iter().any(|it| it.geometry.id == *id);
        let mut ids = (0..IDS).map(|after| (self.next_id + after) % IDS);
        Geometry {
            id: (ids.find(|id| !is_used(id))).expect("there are fewer segments than numbers"),
            stride,
            slots,
            reserved,
        }
    }

    /// Adds a segment as planned. `memory` has the handles of its slots, in order.
    pub(crate) fn add(&mut self, geometry: Geometry, memory: impl IntoIterator<Item = M>) {
        self.next_id = geometry.id + 1;
        let mut free: Vec<_> = (0..geometry.slots)
            .zip(memory)
            .map(|(slot, memory)| Lease {
                segment: geometry,
                slot,
                memory,
            })
            .collect();
        debug_assert_eq!(free.len(), geometry.slots as usize);
        // The first slot is taken first.
        free.reverse();
        self.bytes += geometry.bytes();
        if geometry.reserved {
            self.reserved_bytes += geometry.bytes();
            self.lost = Lost::default();
        }
        let younger = |it: &PoolSegment<M>| it.geometry.stride <= geometry.stride;
        let place = self.segments.partition_point(younger);
        self.segments.insert(
            place,
            PoolSegment {
                geometry,
                free,
                gone: 0,
                retired: false,
                replaced: false,
                touched: true,
            },
        );
        self.check_invariants();
    }

    /// Takes back a slot that no receiver reads any more. Returns the number of its segment if that is freed.
    pub(crate) fn give_back(&mut self, lease: Lease<M>) -> Option<u32> {
        self.used -= lease.segment.stride;
        let place = self.place(lease.segment.id);
        let segment = &mut self.segments[place];
        segment.touched = true;
        if segment.retired {
            return self.lose(place);
        }
        segment.free.push(lease);
        self.check_invariants();
        None
    }

    /// Gives up a slot that must not be written again. Its segment is retired too, unless it is reserved.
    /// Returns the number of the segment if that is freed.
    pub(crate) fn abandon(&mut self, lease: Lease<M>) -> Option<u32> {
        let Geometry {
            id,
            stride,
            reserved,
            ..
        } = lease.segment;
        self.used -= stride;
        let place = self.place(id);
        self.segments[place].touched = true;
        if self.segments[place].retired {
            // Its slots are made up for already, if it is reserved.
        } else if reserved {
            self.lost = Lost {
                stride,
                slots: self.lost.slots + 1,
            };
        } else {
            self.retire(place);
        }
        self.lose(place)
    }

    /// Retires all segments: no further message is written to them. Returns the numbers of those that are freed. Slots
    /// of reserved segments are replaced when they are needed.
    pub(crate) fn replace_all(&mut self) -> Vec<u32> {
        let mut freed = Vec::new();
        for place in (0..self.segments.len()).rev() {
            let segment = &mut self.segments[place];
            if segment.geometry.reserved && !segment.retired {
                let Geometry { stride, slots, .. } = segment.geometry;
                // Lost slots of it are counted already.
                let slots = self.lost.slots + slots - segment.gone;
                self.lost = Lost { stride, slots };
            }
            self.replaced += usize::from(!segment.replaced);
            segment.replaced = true;
            self.retire(place);
            freed.extend(self.remove_if_over(place));
        }
        self.check_invariants();
        freed
    }

    /// Whether no message may be written to this slot any more, although it was leased.
    #[inline]
    pub(crate) fn is_replaced(&self, lease: &Lease<M>) -> bool {
        self.replaced > 0 && self.segments[self.place(lease.segment.id)].replaced
    }

    /// Frees all segments without a slot in use. Returns their numbers.
    pub(crate) fn unused(&mut self) -> Vec<u32> {
        self.give_up(|_| true)
    }

    /// Frees segments without a slot in use since the last sweep. Returns their numbers. Examines the
    /// segments at most once per idle time, however often it is called.
    ///
    /// The youngest segments of a class are freed first. As long as one is in use, older ones are kept,
    /// because they may have to replace it.
    pub(crate) fn sweep(&mut self, now: Instant) -> Vec<u32> {
        if !self.is_sweep_due(now) {
            return Vec::new();
        }
        self.swept = now;
        let mut younger = None;
        for segment in self.segments.iter_mut().rev() {
            segment.touched |= younger == Some(segment.geometry.stride);
            younger = segment.touched.then_some(segment.geometry.stride);
        }
        let idle = self.give_up(|segment| !segment.touched);
        for segment in &mut self.segments {
            segment.touched = false;
        }
        idle
    }

    /// Whether the idle time has passed since the last sweep.
    #[inline]
    pub(crate) fn is_sweep_due(&self, now: Instant) -> bool {
        now.since(self.swept) >= self.idle
    }

    /// The total size of all segments and of messages outside of them.
    pub(crate) const fn bytes(&self) -> u64 {
        self.bytes + self.outside
    }

    /// The memory of messages: slots in use, and messages outside of segments.
    #[inline]
    pub(crate) const fn used(&self) -> u64 {
        self.used
    }

    pub(crate) const fn reserved_bytes(&self) -> u64 {
        self.reserved_bytes
    }

    pub(crate) const fn limit_bytes(&self) -> u64 {
        self.limit_bytes
    }

    /// Lets the pool grow to this size, unless it can already grow further.
    pub(crate) const fn raise_limit(&mut self, bytes: u64) {
        if bytes > self.limit_bytes {
            self.limit_bytes = bytes;
        }
    }

    /// Counts memory of messages outside of segments.
    pub(crate) const fn add_outside(&mut self, bytes: u64) {
        self.outside += bytes;
        self.used += bytes;
    }

    /// Ends the counting of memory that [`add_outside`](Self::add_outside) counted.
    pub(crate) const fn remove_outside(&mut self, bytes: u64) {
        self.outside -= bytes;
        self.used -= bytes;
    }

    /// Whether the limit leaves room for this much outside of segments.
    pub(crate) fn has_room_outside(&self, bytes: u64) -> bool {
        bytes <= self.free_bytes()
    }

    fn free_bytes(&self) -> u64 {
        (self.limit_bytes)
            .saturating_sub(self.bytes - self.reserved_bytes)
            .saturating_sub(self.outside)
    }

    /// Frees the unused segments that `is_so` accepts.
    fn give_up(&mut self, is_so: impl Fn(&PoolSegment<M>) -> bool) -> Vec<u32> {
        let mut ids = Vec::new();
        let bytes = &mut self.bytes;
        self.segments.retain(|segment| {
            let goes = segment.is_unused() && !segment.geometry.reserved && is_so(segment);
            if goes {
                ids.push(segment.geometry.id);
                *bytes -= segment.geometry.bytes();
            }
            !goes
        });
        self.check_invariants();
        ids
    }

    /// Retires a segment: none of its slots is taken any more.
    fn retire(&mut self, place: usize) {
        let segment = &mut self.segments[place];
        segment.retired = true;
        segment.gone += u32::try_from(segment.free.len()).expect("as many as fit a segment");
        segment.free.clear();
    }

    /// Records that one slot of a segment will never come back.
    fn lose(&mut self, place: usize) -> Option<u32> {
        self.segments[place].gone += 1;
        let over = self.remove_if_over(place);
        self.check_invariants();
        over
    }

    /// Removes a segment if none of its slots will come back. Returns its number then.
    fn remove_if_over(&mut self, place: usize) -> Option<u32> {
        let segment = &self.segments[place];
        if segment.gone < segment.geometry.slots {
            return None;
        }
        let PoolSegment {
            geometry, replaced, ..
        } = self.segments.remove(place);
        self.bytes -= geometry.bytes();
        if geometry.reserved {
            self.reserved_bytes -= geometry.bytes();
        }
        self.replaced -= usize::from(replaced);
        Some(geometry.id)
    }

    fn place(&self, id: u32) -> usize {
        (self.segments.iter())
            .position(|segment| segment.geometry.id == id)
            .expect("a lease's segment lives until its last slot is back")
    }

    fn check_invariants(&self) {
        if cfg!(debug_assertions) {
            for segment in &self.segments {
                let Geometry { id, reserved, .. } = segment.geometry;
                assert!(id < IDS);
                assert!(segment.free.iter().all(|it| it.segment == segment.geometry));
                let accounted = segment.free.len() + segment.gone as usize;
                assert!(accounted <= segment.geometry.slots as usize);
                assert!(segment.retired || reserved || segment.gone == 0);
                assert!(!segment.retired || segment.free.is_empty());
                assert!(!segment.retired || segment.replaced || !reserved);
                assert!(segment.retired || !segment.replaced);
            }
            let strides = self.segments.iter().map(|it| it.geometry.stride);
            assert!(strides.is_sorted());
            assert!(self.segments.len() <= SEGMENTS_MAX);
            let replaced = self.segments.iter().filter(|it| it.replaced).count();
            assert_eq!(self.replaced, replaced);
            let bytes = self.segments.iter().map(|it| it.geometry.bytes());
            assert_eq!(self.bytes, bytes.sum::<u64>());
            assert!(self.bytes - self.reserved_bytes <= self.limit_bytes);
        }
    }
}
