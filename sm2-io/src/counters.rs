//! Counters in shared memory: a node writes them, and tools read them at no cost for the node.
//!
//! The format is SPEC section 12; the fields and the arithmetic are
//! [`sm2_proto::counters`]. [`CounterPage`] creates a file and allocates its entries. A [`CounterEntry`] is the one
//! writer of an entry, in any thread. [`CounterView`] is a reader, usually in another process.
//!
//! # Consistent copies
//!
//! Each entry is a seqlock (`seqlock.rs`): a reader copies the words of an entry, and accepts the
//! copy only if the entry's `turn` shows that nothing changed meanwhile. The writer never waits.
//! An entry that is freed and used again continues to count its turns, so no turn repeats.
//!
//! Readers do not trust the writer of the file: the seals fix its size (no fault), a reader copies
//! each word before it interprets it, and the number of attempts is bounded.
//!
//! Reading a shared mapping with atomics is defined by Rust for targets of 64 bits.

mod seqlock;
mod view;

pub use view::{CounterError, CounterView, Entries, Unreadable};

use std::fs::File;
use std::io;
use std::os::fd::{AsFd, BorrowedFd};
use std::sync::Arc;

use sm2_proto::counters::{
    ENTRY_FIELDS, Entry, MAX_ENTRIES, MAX_FILE_BYTES, field, header, recent_index,
};
use sm2_proto::link::{Counters, Fate};
use sm2_proto::{Instant, InterfaceId, LinkId, Seals};

use crate::mapping::writable::MappingMut;
use crate::memfd::file::{add_seals, create};
use crate::sync::{AtomicU64, Ordering};

use self::seqlock::Change;

/// A file of counters, which only this value and its entries can write.
///
/// The file has room for [`MAX_ENTRIES`] entries, but takes memory only for entries that were used:
/// 4 KiB for each eight of them.
#[derive(Debug)]
pub struct CounterPage {
    mapping: Arc<MappingMut>,
    file: File,
    /// Entries with this number and higher ones were never used.
    fresh: u32,
    /// The freed entries, with the turns of their last changes.
    freed: Vec<(u32, u64)>,
}

/// The only writer of one entry of a [`CounterPage`], from [`CounterPage::allocate`]. Give it
/// back with [`CounterPage::free`]; one that is dropped leaves its entry in use.
#[derive(Debug)]
#[must_use = "the entry stays in use until it is given to `free`"]
pub struct CounterEntry {
    mapping: Arc<MappingMut>,
    index: u32,
    /// The turn of the last change.
    turn: u64,
}

impl CounterEntry {
    /// The entry's number, from 0, as [`CounterView::read`] takes it.
    #[must_use]
    pub const fn index(&self) -> u32 {
        self.index
    }

    /// Starts a change of the entry, which ends when the result is dropped. Readers retry until
    /// then: do nothing else in between.
    //= SM2-CNT-006
    #[inline]
    pub fn update(&mut self) -> Update<'_> {
        let words = entry_words(self.mapping.words(), self.index);
        Update {
            change: Change::begin(words, &mut self.turn),
        }
    }
}

impl CounterPage {
    /// Creates a file without entries in use.
    ///
    /// # Errors
    ///
    /// Any error of `memfd_create(2)`, `ftruncate(2)` and `mmap(2)`, such as too many descriptors or
    /// no memory.
    //= SM2-CNT-004
    pub fn new() -> io::Result<Self> {
        let file = create(c"sm2-counters", MAX_FILE_BYTES)?;
        let mapping = MappingMut::new(file.as_fd(), MAX_FILE_BYTES, false)?;
        mapping.keep_sparse();
        for (word, value) in mapping.words().iter().zip(header(MAX_ENTRIES)) {
            word.store(value.to_le(), Ordering::Relaxed);
        }
        // After mapping: the seals forbid new writable mappings.
        add_seals(&file, Seals::POOLED)?;
        Ok(Self {
            mapping: Arc::new(mapping),
            file,
            fresh: 0,
            freed: Vec::new(),
        })
    }

    /// Allocates an entry for an interface as a whole, or for its end of a link, with all counts
    /// zero, `created` at that time. `None` if all [`MAX_ENTRIES`] are in use.
    pub fn allocate(
        &mut self,
        interface: InterfaceId,
        link: Option<LinkId>,
        created: Instant,
    ) -> Option<CounterEntry> {
        let (index, turn) = match self.freed.pop() {
            Some(freed) => freed,
            None if self.fresh < MAX_ENTRIES => {
                self.fresh += 1;
                (self.fresh - 1, 0)
            }
            None => return None,
        };
        let mut entry = CounterEntry {
            mapping: Arc::clone(&self.mapping),
            index,
            turn,
        };
        let blank = Entry {
            interface,
            link,
            created,
            ..Entry::default()
        };
        let mut update = entry.update();
        let words = blank.to_words(0);
        for (field, value) in words.into_iter().enumerate().skip(field::TURN + 1) {
            update.set(field, value);
        }
        drop(update);
        Some(entry)
    }

    /// Frees an entry. Readers no longer see it; a later allocation may reuse it.
    //= SM2-CNT-006
    pub fn free(&mut self, entry: CounterEntry) {
        debug_assert!(Arc::ptr_eq(&self.mapping, &entry.mapping));
        seqlock::free(entry_words(self.mapping.words(), entry.index));
        self.freed.push((entry.index, entry.turn));
    }
}

/// The descriptor for readers, which forbids writing.
impl AsFd for CounterPage {
    fn as_fd(&self) -> BorrowedFd<'_> {
        self.file.as_fd()
    }
}

/// The words of entry `index`, which must be within the file.
#[inline]
fn entry_words(file: &[AtomicU64], index: u32) -> &[AtomicU64; ENTRY_FIELDS] {
    // The header is as long as an entry.
    let first = (index as usize + 1) * ENTRY_FIELDS;
    file[first..]
        .first_chunk()
        .expect("entries are numbered within the file")
}

/// A change of one entry. It ends, and readers see it, when this value is dropped.
///
/// Writes fates only if they differ; does not allocate and makes no system call.
/// Sums wrap around at 2^64.
#[derive(Debug)]
pub struct Update<'a> {
    change: Change<'a, ENTRY_FIELDS>,
}

//= SM2-CNT-005
impl Update<'_> {
    /// Sending side: counts a message (or call) of `len_bytes` that was published `at` this time.
    #[inline]
    pub fn published(&mut self, at: Instant, len_bytes: u64) {
        self.count(at, len_bytes, at.0);
    }

    /// Receiving side: counts a message (or request) of `len_bytes` that the application took `at`
    /// this time, and that was `published` at that time.
    #[inline]
    pub fn taken(&mut self, at: Instant, published: Instant, len_bytes: u64) {
        // A publication time in the future counts as no delay.
        let delay_ns = at.0.saturating_sub(published.0);
        self.count(at, len_bytes, delay_ns);
        self.add(field::DELAY_SUM, delay_ns);
        if delay_ns > self.get(field::DELAY_MAX) {
            self.set(field::DELAY_MAX, delay_ns);
        }
    }

    /// Counts messages that were lost before the application saw them.
    #[inline]
    pub fn lost(&mut self, messages: u64) {
        self.add(field::LOST, messages);
    }

    /// Subscriber: counts those of the [lost](Self::lost) messages that were published while their publisher had no
    /// link with the subscriber. End of a link: counts such messages before the link, which are not lost on it.
    #[inline]
    pub fn away(&mut self, messages: u64) {
        self.add(field::AWAY, messages);
    }

    /// Receiving side: counts messages that were older than their lifespan when the application would have taken them.
    pub fn expired(&mut self, messages: u64) {
        self.add(Fate::Expired.position(), messages);
    }

    /// Subscriber's end of a link: the messages that the application holds.
    #[inline]
    pub fn held(&mut self, messages: u64) {
        self.change.put(field::HELD, messages);
    }

    /// Subscriber's end of a link: the greatest number of messages that the application can hold.
    pub fn max_held(&mut self, messages: u64) {
        self.set(field::MAX_HELD, messages);
    }

    /// Sending side: the fates of the link's messages so far.
    #[inline]
    pub fn fates(&mut self, fates: &Counters) {
        self.set(field::OFFERED, fates.offered);
        self.set(field::IN_FLIGHT, fates.in_flight);
        for fate in Fate::ALL {
            self.set(fate.position(), fates.of(fate));
        }
    }

    /// Sending side: those of the [fates](Self::fates) that sending a message changes.
    #[inline]
    pub fn sent(&mut self, fates: &Counters) {
        self.set(field::OFFERED, fates.offered);
        for fate in [Fate::Delivered, Fate::Overwritten, Fate::Discarded] {
            self.set(fate.position(), fates.of(fate));
        }
        self.set(field::IN_FLIGHT, fates.in_flight);
    }

    /// Publisher: counts a message that was published while no link was open.
    pub fn unheard(&mut self) {
        self.add(field::UNHEARD, 1);
    }

    /// Publisher, subscriber or its end of a link: counts periods of the deadline that passed without a message.
    pub fn missed_deadlines(&mut self, periods: u64) {
        self.add(field::MISSED_DEADLINES, periods);
    }

    /// Publisher, subscriber or its end of a link: counts that the publisher stopped being alive.
    pub fn lost_liveliness(&mut self) {
        self.add(field::LOST_LIVELINESS, 1);
    }

    /// End of a link: the time when the node became short of memory on the link, or that it is not.
    pub fn short_since(&mut self, since: Option<Instant>) {
        self.set(field::SHORT_SINCE, since.map_or(0, |since| since.0));
    }

    #[inline]
    fn count(&mut self, at: Instant, len_bytes: u64, recent: u64) {
        let message = self.add(field::MESSAGES, 1);
        self.add(field::BYTES, len_bytes);
        self.change.put(field::LAST, at.0);
        self.change
            .put(field::RECENT + recent_index(message), recent);
    }

    /// This process is the only writer, so reading and writing need not be one atomic step.
    #[inline]
    fn add(&mut self, field: usize, more: u64) -> u64 {
        let sum = self.get(field).wrapping_add(more);
        self.change.put(field, sum);
        sum
    }

    #[inline]
    fn get(&self, field: usize) -> u64 {
        self.change.get(field)
    }

    #[inline]
    fn set(&mut self, field: usize, value: u64) {
        self.change.set(field, value);
    }
}
