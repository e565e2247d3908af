//! The slots of a segment, each with one owner.
//!
//! [`Segment`] leaves it to its caller who uses which slot. Here that question is
//! answered by ownership: a segment is split once, and each [`Slot`] is the only
//! right to its bytes in this process.

use std::fmt;
use std::os::fd::{AsFd, BorrowedFd};
use std::sync::Arc;

use crate::memfd::Segment;

/// The exclusive right to one slot of a segment. The segment lives as long as
/// any of its slots, or a [`SegmentFd`] of it.
///
/// Receivers are other processes and map the segment for reading only. An owner
/// that lends a slot to them must not write again until they have given it back:
/// see [`mapping`](crate::mapping) for what they see otherwise. Keeping the slot in a
/// place from which nobody writes, until then, is all that it takes.
pub struct Slot {
    segment: Arc<Segment>,
    index: u32,
    /// How many bytes were made ready for writing.
    warm: usize,
}

/// The descriptor of a split segment, to hand to receivers.
#[derive(Clone, Debug)]
pub struct SegmentFd(Arc<Segment>);

impl Segment {
    /// Gives every slot an owner. Slots come in the order of their numbers.
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

    /// Gets the memory for the first `len` bytes in huge pages, if they are many, there are such
    /// pages, and this was not done before. What the bytes are does not change, and nothing else
    /// depends on it: without it, they come when they are written, one small page at a time.
    pub fn warm(&mut self, len: usize) {
        if len > self.warm {
            self.warm = len;
            self.segment.warm(self.index, len);
        }
    }

    /// The first `len` bytes.
    ///
    /// # Panics
    ///
    /// If the slot is shorter.
    #[must_use]
    #[inline]
    pub fn bytes(&self, len: usize) -> &[u8] {
        // SAFETY: `split` took the segment by value and made one `Slot` for each number, which
        // cannot be cloned; nothing else calls `slot_mut` on it. A writer needs `&mut` of this
        // value, so none exists while `self` is borrowed.
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
        // SAFETY: as in `bytes`, and `self` is borrowed exclusively: no other reference to this
        // slot's bytes exists in this process. That no receiver holds the slot is the protocol's
        // promise that every reader of shared memory depends on (`mapping`): the owner does not
        // write while the slot is lent.
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
        let file = InspectedFd::new(owned(&fd)).into_pooled().unwrap();
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
    fn a_slot_outlives_the_handle_of_its_segment() {
        let (fd, mut slots) = Segment::create(4096, 1).unwrap().split();
        drop(fd);
        let mut slot = slots.remove(0);
        slot.bytes_mut(5).copy_from_slice(b"alive");
        assert_eq!((slot.bytes(5), slot.len_bytes()), (&b"alive"[..], 4096));
    }
}
