//! Which slot of which segment is free: bookkeeping alone.
//!
//! A [`Pool`] holds what stands for the memory of free slots, without touching it, and
//! says how large the next segment is to be. It knows neither links nor messages:
//! its owner, the [outbox](crate::driver), gives a slot back when nobody needs it any more.
//!
//! - Sizes of slots are powers of two and what lies halfway between two of them: 128 bytes at least,
//!   multiples of 64 below a page and of 4 KiB above it, and of 2 MiB from there on, so that each slot
//!   begins with a huge page. Slots of one size form a class. The last [`HEAD_BYTES`] of a slot are no message's.
//! - Of a class, a slot of the oldest segment is taken, and there the one that was given back
//!   last: its memory is still in a cache. Slots that were never needed cost no memory at all, and
//!   those of younger segments are needed by nobody again, once a rush is over. If the class has
//!   none, one of a size up to twice as large will do: messages whose lengths vary need no
//!   memory for each length.
//! - A class that has no free slot gets a segment with as many slots as it has
//!   already. So segments are few: their number grows with the logarithm of the need.
//! - A segment of which nobody used a slot for a while [goes](Pool::sweep). Only whole segments
//!   can: their seals forbid holes.
//! - A slot can be *abandoned*: never to be written again, since somebody might still
//!   read it. Its segment then serves no further message, and is over when the last of its
//!   slots is back.
//! - A segment can be *reserved*: it is there from the beginning, beyond the limit, for messages
//!   of any length that fits, and is never freed for being idle. An abandoned slot of it is lost alone, and
//!   replaced when it is missed.

use std::time::Duration;

use sm2_proto::Instant;
use sm2_proto::limits::{MESSAGE_MAX, SEGMENT_BYTES_MAX, SEGMENTS_MAX, SLOTS_MAX, STRIDE_UNIT};

#[cfg(test)]
mod tests;

/// How many bytes at the end of each slot are left for the message's head.
pub(crate) const HEAD_BYTES: u64 = sm2_proto::limits::SLOT_HEAD as u64;

/// How long a segment is kept that nobody uses, unless a builder says otherwise.
pub(crate) const IDLE_DEFAULT: Duration = Duration::from_secs(5);

/// The upper bound of segment numbers, which have 15 bits (SM2-RNG-003).
const IDS: u32 = 1 << 15;

/// The size of the smallest slot: two cache lines that come together.
const STRIDE_MIN: u64 = 128;

/// Slots of at least this size are a multiple of it.
const PAGE: u64 = 4 << 10;

/// The same of a large slot.
const HUGE_PAGE: u64 = 2 << 20;

/// Free slots, whose memory is an `M` each.
#[derive(Debug)]
pub(crate) struct Pool<M> {
    /// By size of the slot, and of one size the oldest first. A few, 256 at most.
    segments: Vec<Segment<M>>,
    next_id: u32,
    limit_bytes: u64,
    /// The size of all segments together, and that of those which are reserved.
    bytes: u64,
    reserved_bytes: u64,
    /// Slots of reserved segments that never come back.
    lost: Lost,
    idle: Duration,
    swept: Instant,
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
    /// Whether it is there whatever the limit, used or not.
    pub(crate) reserved: bool,
}

/// There is no room for one more slot of this size.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Full;

#[derive(Debug)]
struct Segment<M> {
    geometry: Geometry,
    /// The last of them is taken first.
    free: Vec<Lease<M>>,
    /// Slots that never come back.
    gone: u32,
    retired: bool,
    /// Whether a slot was taken or given back since the last sweep.
    touched: bool,
}

/// How many slots of which size are to be made up for.
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

impl<M> Segment<M> {
    fn is_unused(&self) -> bool {
        self.free.len() == self.geometry.slots as usize
    }
}

impl<M> Pool<M> {
    /// An empty pool, which grows to at most `limit_bytes`.
    pub(crate) const fn new(limit_bytes: u64) -> Self {
        Self {
            segments: Vec::new(),
            next_id: 0,
            limit_bytes,
            bytes: 0,
            reserved_bytes: 0,
            lost: Lost {
                stride: 0,
                slots: 0,
            },
            idle: IDLE_DEFAULT,
            swept: Instant(0),
        }
    }

    /// Segments that nobody uses are kept so long.
    pub(crate) const fn keep_idle(&mut self, idle: Duration) {
        self.idle = idle;
    }

    /// A free slot for `len` bytes and a head.
    pub(crate) fn take(&mut self, len: u64) -> Option<Lease<M>> {
        let stride = stride_for(len);
        let first = (self.segments).partition_point(|it| it.geometry.stride < stride);
        let segment = self.segments[first..]
            .iter_mut()
            .filter(|it| it.geometry.stride <= 2 * stride || it.geometry.reserved)
            .find(|it| !it.free.is_empty())?;
        segment.touched = true;
        let lease = segment.free.pop();
        self.check_invariants();
        lease
    }

    /// The segment to [add](Self::add), so that `len` bytes find a slot.
    ///
    /// # Errors
    ///
    /// [`Full`]: the limit leaves no room, even if [unused](Self::unused) segments go.
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
        let room = (self.limit_bytes).saturating_sub(self.bytes - self.reserved_bytes);
        let most = room.min(SEGMENT_BYTES_MAX) / stride;
        let wanted = u64::from(has.max(first_slots(stride)).min(SLOTS_MAX));
        match u32::try_from(wanted.min(most)) {
            Ok(0) | Err(_) => Err(Full),
            Ok(slots) => Ok(self.geometry(stride, slots, false)),
        }
    }

    /// The segment to [add](Self::add), so that there are so many slots for `len` bytes for ever.
    ///
    /// # Errors
    ///
    /// [`Full`]: no segment can be so large.
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
        // As late as possible, a number is used again.
        let is_used = |id: &u32| self.segments.iter().any(|it| it.geometry.id == *id);
        let mut ids = (0..IDS).map(|after| (self.next_id + after) % IDS);
        Geometry {
            id: (ids.find(|id| !is_used(id))).expect("there are fewer segments than numbers"),
            stride,
            slots,
            reserved,
        }
    }

    /// Adds a segment as planned; `memory` is that of its slots, in order.
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
        let younger = |it: &Segment<M>| it.geometry.stride <= geometry.stride;
        let place = self.segments.partition_point(younger);
        self.segments.insert(
            place,
            Segment {
                geometry,
                free,
                gone: 0,
                retired: false,
                touched: true,
            },
        );
        self.check_invariants();
    }

    /// Takes back a slot that nobody reads any more. The number of its segment, if that is over.
    pub(crate) fn give_back(&mut self, lease: Lease<M>) -> Option<u32> {
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

    /// Gives up a slot that must not be written again, and its segment with it, unless that is
    /// reserved. The segment's number, if it is over.
    pub(crate) fn abandon(&mut self, lease: Lease<M>) -> Option<u32> {
        let Geometry {
            id,
            stride,
            reserved,
            ..
        } = lease.segment;
        let place = self.place(id);
        self.segments[place].touched = true;
        if reserved {
            self.lost = Lost {
                stride,
                slots: self.lost.slots + 1,
            };
        } else {
            self.retire(place);
        }
        self.lose(place)
    }

    /// Gives up all segments of which every slot is free; their numbers.
    pub(crate) fn unused(&mut self) -> Vec<u32> {
        self.give_up(|_| true)
    }

    /// Gives up all segments of which no slot was in use since the last sweep, which was as long
    /// ago as segments are kept, at least; their numbers. Looks at the segments once in that time,
    /// however often it is called.
    ///
    /// The youngest of a class go first: as long as one is in use, older ones may have to serve in
    /// its place, and are kept.
    pub(crate) fn sweep(&mut self, now: Instant) -> Vec<u32> {
        if now.since(self.swept) < self.idle {
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

    /// The size of all segments together.
    pub(crate) const fn bytes(&self) -> u64 {
        self.bytes
    }

    /// Gives up unused segments that are like this.
    fn give_up(&mut self, is_so: impl Fn(&Segment<M>) -> bool) -> Vec<u32> {
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

    /// No slot of this segment is handed out any more.
    fn retire(&mut self, place: usize) {
        let segment = &mut self.segments[place];
        segment.retired = true;
        segment.gone += u32::try_from(segment.free.len()).expect("as many as fit a segment");
        segment.free.clear();
    }

    /// One slot of a segment never comes back.
    fn lose(&mut self, place: usize) -> Option<u32> {
        let segment = &mut self.segments[place];
        segment.gone += 1;
        let over = segment.gone == segment.geometry.slots;
        let geometry = segment.geometry;
        if over {
            self.segments.remove(place);
            self.bytes -= geometry.bytes();
            if geometry.reserved {
                self.reserved_bytes -= geometry.bytes();
            }
        }
        self.check_invariants();
        over.then_some(geometry.id)
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
                assert!(!segment.retired || (segment.free.is_empty() && !reserved));
            }
            let strides = self.segments.iter().map(|it| it.geometry.stride);
            assert!(strides.is_sorted());
            assert!(self.segments.len() <= SEGMENTS_MAX);
            let bytes = self.segments.iter().map(|it| it.geometry.bytes());
            assert_eq!(self.bytes, bytes.sum::<u64>());
            assert!(self.bytes - self.reserved_bytes <= self.limit_bytes);
        }
    }
}

/// The size of the slot for a message of `len` bytes and its head.
pub(crate) const fn stride_for(len: u64) -> u64 {
    let least = len.saturating_add(HEAD_BYTES);
    let whole = if least > STRIDE_MIN {
        least.next_power_of_two()
    } else {
        STRIDE_MIN
    };
    let half_step = whole / 4 * 3;
    let size = if least <= half_step { half_step } else { whole };
    let unit = match size {
        ..PAGE => STRIDE_UNIT,
        PAGE..HUGE_PAGE => PAGE,
        HUGE_PAGE.. => HUGE_PAGE,
    };
    size.next_multiple_of(unit)
}

/// How many slots the first segment of a class has.
const fn first_slots(stride: u64) -> u32 {
    match stride {
        // A page of them.
        0..=0x80 => 32,
        0x81..=0x1_0000 => 16,
        0x1_0001..=0x10_0000 => 4,
        _ => 1,
    }
}
