//! The slots of a segment, each with one owner.
//!
//! A [`Segment`] does not track which slot is in use. This module tracks that by ownership: a segment
//! is split once, and each [`Slot`] is the only access to its bytes in this process.

use std::fmt;
use std::os::fd::{AsFd, BorrowedFd};
use std::sync::Arc;

use crate::memfd::Segment;

/// The exclusive right to one slot of a segment. The segment exists as long as any of its slots, or a
/// [`SegmentFd`] of it.
///
/// Receivers map the segment for reading only. An owner that sends a message in a slot must not write to
/// the slot until all receivers have released the message (SM2-PAY-005):
/// [`mapping`](crate::mapping) says what they see otherwise. `sm2-node` keeps such slots where no code
/// writes to them.
pub struct Slot {
    segment: Arc<Segment>,
    index: u32,
    /// The number of bytes that were warmed.
    warm: usize,
}

/// The descriptor of a split segment, for receivers.
#[derive(Clone, Debug)]
pub struct SegmentFd(Arc<Segment>);

/// A segment that is on its way back to the system: nothing in this process uses it.
///
/// Dropping it gives back the rest at once. That takes long for a large segment, and delays other threads of the
/// process, since the kernel locks the table of mappings meanwhile.
#[derive(Debug)]
pub struct UnusedSegment(Segment);

impl SegmentFd {
    /// The segment, to give it back in parts. `None` if a slot or another descriptor of it exists; the last one of them
    /// gives it back.
    #[must_use]
    pub fn into_unused(self) -> Option<UnusedSegment> {
        Arc::into_inner(self.0).map(UnusedSegment)
    }
}

impl UnusedSegment {
    /// Unmaps the last `bytes`, rounded up to a multiple of 2 MiB. Returns whether nothing is left but the file, which
    /// dropping this value closes.
    pub fn unmap_part(&mut self, bytes: usize) -> bool {
        self.0.unmap_last(bytes)
    }
}

impl Segment {
    /// Makes an owner of each slot, in the order of their numbers.
    #[must_use]
    pub fn split(self) -> (SegmentFd, Vec<Slot>) {
        let warm = if self.is_present() { usize::MAX } else { 0 };
        let segment = Arc::new(self);
        let slots = (0..segment.slots())
            .map(|index| Slot {
                segment: Arc::clone(&segment),
                index,
                warm,
            })
            .collect();
        (SegmentFd(segment), slots)
    }
}

impl Slot {
    /// The slot's number in its segment.
    #[must_use]
    #[inline]
    pub const fn index(&self) -> u32 {
        self.index
    }

    /// The slot's length in bytes.
    #[must_use]
    #[inline]
    pub fn len_bytes(&self) -> usize {
        self.segment.stride_bytes()
    }

    /// Makes the first `len` bytes present in huge pages, if they are many, the kernel has huge pages,
    /// and this was not done before. No byte changes. Otherwise each small page appears when it is first
    /// written.
    pub fn warm(&mut self, len: usize) {
        if len > self.warm {
            self.warm = len;
            self.segment.warm(self.index, len);
        }
    }

    /// Prefetches the first and the last cache line, which are about to be written: a receiver read them last.
    #[inline]
    pub fn prefetch_to_write(&self) {
        self.segment.prefetch_to_write(self.index);
    }

    /// The first `len` bytes.
    ///
    /// # Panics
    ///
    /// If the slot is shorter.
    #[must_use]
    #[inline]
    pub fn bytes(&self, len: usize) -> &[u8] {
        // SAFETY: `split` took the segment by value and made one `Slot` for each number, which cannot
        // be cloned, and only `bytes_mut` calls `slot_mut` on a split segment. A writer needs `&mut` of
        // this value, so none exists while `self` is borrowed.
        unsafe { self.segment.slot(self.index, len) }
    }

    /// The first `len` bytes, for writing.
    ///
    /// # Panics
    ///
    /// If the slot is shorter.
    #[must_use]
    #[inline]
    pub fn bytes_mut(&mut self, len: usize) -> &mut [u8] {
        // SAFETY: as in `bytes`, and `self` is borrowed exclusively: no other reference to the bytes of
        // this slot exists that this crate made, since it gives out foreign mappings of them as copies
        // and raw pointers alone. Receivers never write. A receiver that makes a slice of the slot in
        // `unsafe` code relies on the owner to keep SM2-PAY-005, and answers for that.
        unsafe { self.segment.slot_mut(self.index, len) }
    }
}

impl fmt::Debug for Slot {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Slot").field("index", &self.index).finish()
    }
}

impl AsFd for SegmentFd {
    fn as_fd(&self) -> BorrowedFd<'_> {
        self.0.fd()
    }
}

#[cfg(test)]
mod tests {
    use std::os::fd::{AsFd, OwnedFd};

    use crate::{InspectedFd, PooledMapping, Segment};

    fn owned(fd: &impl AsFd) -> OwnedFd {
        fd.as_fd().try_clone_to_owned().unwrap()
    }

    #[test]
    fn each_slot_has_its_own_bytes_and_receivers_see_them() {
        let (fd, mut slots) = Segment::create(4096, 3).unwrap().split();
        for slot in &mut slots {
            let mark = u8::try_from(slot.index()).unwrap() + 1;
            slot.bytes_mut(4096).fill(mark);
        }
        let file = InspectedFd::new(owned(&fd)).unwrap().into_pooled().unwrap();
        let seen = PooledMapping::new(&file, 3 * 4096, false).unwrap();
        for (index, slot) in slots.iter().enumerate() {
            let mark = u8::try_from(index).unwrap() + 1;
            assert_eq!(slot.index() as usize, index);
            assert!(slot.bytes(4096).iter().all(|&byte| byte == mark));
            let lent = seen.copy_to_vec(index as u64 * 4096, 4096).unwrap();
            assert_eq!(lent, slot.bytes(4096));
        }
    }

    #[test]
    fn a_segment_without_slots_is_given_back_in_parts() {
        const MIB: usize = 1 << 20;
        let (fd, slots) = Segment::create(3 << 20, 3).unwrap().split();
        assert!(fd.clone().into_unused().is_none(), "another descriptor");
        drop(slots);
        let start = fd.0.slot_ptr(0).addr();
        let mut unused = fd.into_unused().unwrap();
        // 9 MiB are mapped as 10: 6, 4, 2 and 0 are left.
        let mapped = |bytes: usize| {
            let maps = std::fs::read_to_string("/proc/self/maps").unwrap();
            let range = format!("{start:x}-{:x} ", start + bytes);
            maps.lines().any(|line| line.starts_with(&range))
        };
        assert!(mapped(10 * MIB));
        for (part, left) in [(4, 6), (1, 4), (2, 2)] {
            assert!(!unused.unmap_part(part * MIB));
            assert!(mapped(left * MIB), "{left}");
        }
        assert!(unused.unmap_part(MIB));
        assert!(unused.unmap_part(MIB), "nothing is left");
    }

    #[test]
    fn a_slot_outlives_the_handle_of_its_segment() {
        let (fd, mut slots) = Segment::create(4096, 1).unwrap().split();
        drop(fd);
        let mut slot = slots.remove(0);
        slot.bytes_mut(5).copy_from_slice(b"alive");
        assert_eq!((slot.bytes(5), slot.len_bytes()), (&b"alive"[..], 4096));
    }
}
