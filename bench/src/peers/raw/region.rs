//! Memory that processes share: a few counters, and slots for messages.
//!
//! The publisher writes message `n` into slot `n % slots` when every subscriber has consumed the
//! earlier message in that slot, and then counts message `n` as published. Each subscriber takes
//! the messages in order and counts them as consumed.

use std::{
    fs::{File, OpenOptions},
    io,
    num::NonZeroUsize,
    path::Path,
    ptr::NonNull,
    slice,
    sync::atomic::{AtomicU32, AtomicU64, Ordering},
};

use nix::sys::mman::{MapFlags, ProtFlags, mmap, munmap};

/// The count of consumed messages of a place without a subscriber.
pub(super) const FREE: u64 = u64::MAX;

/// The largest number of subscribers.
pub(super) const PLACES: usize = 16;

/// The offset of the first slot: one page.
const SLOTS_AT: usize = 4_096;

/// A value with two cache lines for itself: processors fetch lines in pairs.
#[repr(C, align(128))]
pub(super) struct Line<T>(pub(super) T);

/// The start of the memory. All zero is a valid value.
#[repr(C)]
pub(super) struct Counters {
    /// The number of published messages.
    pub(super) published: Line<AtomicU64>,
    /// The futex of subscribers; changes with each wake-up.
    pub(super) bell: Line<AtomicU32>,
    /// The number of subscribers that sleep or are about to sleep.
    pub(super) sleepers: Line<AtomicU32>,
    /// The futex of the publisher; changes with each wake-up.
    pub(super) room_bell: Line<AtomicU32>,
    /// 1 if the publisher sleeps or is about to sleep.
    pub(super) room_sleepers: Line<AtomicU32>,
    /// One more than the number of messages that each subscriber has consumed; 0 is `FREE`.
    consumed: [Line<AtomicU64>; PLACES],
}

impl Counters {
    /// The number of messages that this subscriber has consumed.
    pub(super) fn consumed(&self, place: usize) -> u64 {
        self.consumed[place]
            .0
            .load(Ordering::Acquire)
            .wrapping_sub(1)
    }

    /// Sets the number of messages that this subscriber has consumed.
    pub(super) fn consume(&self, place: usize, count: u64) {
        self.consumed[place]
            .0
            .store(count.wrapping_add(1), Ordering::Release);
    }

    /// Takes a place for a subscriber, which receives all messages published from now on.
    pub(super) fn join(&self) -> Option<usize> {
        (0..PLACES).find(|&place| {
            let now = self.published.0.load(Ordering::Acquire) + 1;
            self.consumed[place]
                .0
                .compare_exchange(0, now, Ordering::AcqRel, Ordering::Relaxed)
                .is_ok()
        })
    }

    /// The number of subscribers.
    pub(super) fn joined(&self) -> usize {
        let places = 0..PLACES;
        places.filter(|&place| self.consumed(place) != FREE).count()
    }

    /// The number of messages that the slowest subscriber has consumed; `FREE` without subscribers.
    pub(super) fn slowest(&self) -> u64 {
        let consumed = (0..PLACES).map(|place| self.consumed(place));
        consumed.min().unwrap_or(FREE)
    }
}

/// The mapped memory.
pub(super) struct Region {
    start: NonNull<u8>,
    bytes: NonZeroUsize,
    stride: usize,
    slots: usize,
}

// SAFETY: the mapping belongs to the process, not to a thread. It is accessed through atomics, and
// through slots that the counters reserve for one writer or for readers.
unsafe impl Send for Region {}

impl Region {
    /// Makes the memory, or opens the existing one of the same `len` and `slots`.
    pub(super) fn open(path: &Path, len: usize, slots: usize) -> io::Result<Self> {
        let align = if len >= 4_096 { 4_096 } else { 64 };
        let stride = len.next_multiple_of(align);
        let bytes = NonZeroUsize::MIN.saturating_add(SLOTS_AT + stride * slots - 1);
        let mut options = OpenOptions::new();
        let file = options.read(true).write(true).create(true).truncate(false);
        let file: File = file.open(path)?;
        file.set_len(bytes.get() as u64)?;
        let protection = ProtFlags::PROT_READ | ProtFlags::PROT_WRITE;
        // SAFETY: a new mapping at an address that the kernel chooses touches no other memory.
        let start = unsafe { mmap(None, bytes, protection, MapFlags::MAP_SHARED, &file, 0)? };
        Ok(Self {
            start: start.cast(),
            bytes,
            stride,
            slots,
        })
    }

    /// The counters.
    pub(super) fn counters(&self) -> &Counters {
        const { assert!(size_of::<Counters>() <= SLOTS_AT) };
        // SAFETY: the mapping is longer than the counters, aligned to a page, lives as long as
        // `self`, and holds zeros or what other processes wrote through the same atomics,
        // where every bit pattern is a value.
        unsafe { self.start.cast::<Counters>().as_ref() }
    }

    pub(super) const fn slots(&self) -> usize {
        self.slots
    }

    fn slot(&self, number: u64) -> NonNull<u8> {
        let at = SLOTS_AT + (number % self.slots as u64) as usize * self.stride;
        // SAFETY: the slot is inside the mapping, which was made that long.
        unsafe { self.start.add(at) }
    }

    /// The memory of message `number`, for its publisher.
    ///
    /// # Safety
    ///
    /// The caller is the only publisher, and every subscriber has consumed the earlier message in
    /// the slot.
    pub(super) unsafe fn write(&mut self, number: u64, len: usize) -> &mut [u8] {
        assert!(
            len <= self.stride,
            "longer than the channel's longest message"
        );
        // SAFETY: the slot is inside the mapping; the caller guarantees that nobody else accesses it.
        unsafe { slice::from_raw_parts_mut(self.slot(number).as_ptr(), len) }
    }

    /// Message `number`, for a subscriber.
    ///
    /// # Safety
    ///
    /// The message is published, and this subscriber has not consumed it yet.
    pub(super) unsafe fn read(&self, number: u64, len: usize) -> &[u8] {
        assert!(
            len <= self.stride,
            "longer than the channel's longest message"
        );
        // SAFETY: the slot is inside the mapping. The publisher does not write to it before this
        // subscriber has consumed the message, which the caller guarantees not to have happened.
        unsafe { slice::from_raw_parts(self.slot(number).as_ptr(), len) }
    }
}

/// The number of slots for messages of this length. Large messages have two: one is read while
/// the next one is written. Small ones have many, so that both sides wait less often.
pub(super) const fn slots(len: usize) -> usize {
    match len {
        0..=4_096 => 1_024,
        4_097..=262_144 => 8,
        _ => 2,
    }
}

impl Drop for Region {
    fn drop(&mut self) {
        // SAFETY: this is the mapping of `open`, and no borrow of it is left. An error could only
        // mean that nothing is mapped there, which is the intended state.
        let _ = unsafe { munmap(self.start.cast(), self.bytes.get()) };
    }
}

#[cfg(test)]
mod tests {
    use super::{FREE, PLACES, Region};

    #[test]
    fn two_processes_see_one_memory() {
        let dir = tempfile::tempdir().unwrap();
        let mut one = Region::open(&dir.path().join("shared"), 64, 2).unwrap();
        let other = Region::open(&dir.path().join("shared"), 64, 2).unwrap();
        // SAFETY: no subscriber is there, and there is one publisher.
        unsafe { one.write(3, 64) }.fill(7);
        // SAFETY: the publisher has stopped writing.
        assert_eq!(unsafe { other.read(3, 64) }, [7; 64]);
        // SAFETY: as above.
        assert_eq!(unsafe { other.read(2, 64) }, [0; 64]);
    }

    #[test]
    fn the_slowest_decides_and_places_are_used_again() {
        let dir = tempfile::tempdir().unwrap();
        let region = Region::open(&dir.path().join("shared"), 64, 2).unwrap();
        let counters = region.counters();
        assert_eq!((counters.joined(), counters.slowest()), (0, FREE));
        let places: Vec<_> = (0..PLACES).map_while(|_| counters.join()).collect();
        assert_eq!((places.len(), counters.join()), (PLACES, None));
        places.iter().for_each(|&place| counters.consume(place, 9));
        counters.consume(5, 4);
        assert_eq!(counters.slowest(), 4);
        counters.consume(5, FREE);
        assert_eq!((counters.joined(), counters.slowest()), (15, 9));
        assert_eq!(counters.join(), Some(5));
    }
}
