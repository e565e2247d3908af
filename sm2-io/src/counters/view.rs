//! Reading the counters of another process.

use std::fs::File;
use std::hint;
use std::io;
use std::os::fd::OwnedFd;
use std::thread;

use nix::errno::Errno;
use sm2_proto::Seals;
use sm2_proto::counters::{ENTRY_BYTES, Entry, entries_in, field, header};

use crate::mapping::PooledMapping;
use crate::memfd::{InspectedFd, VerifyError};
use crate::syscall::files::{self, Whence};

use super::{entry_words, seqlock};

/// Attempts to read an entry that changes meanwhile. A change takes some nanoseconds; if one
/// outlasts this many attempts, its writer was stopped or is hostile.
const TRIES: u32 = 24;
/// Attempts beyond the first for all entries together: bounds the cost of a hostile file.
const TRIES_FOR_ALL: u32 = 240;
/// Attempts before the reader yields the processor, in case the writer waits for it. Each further
/// attempt may take as long as other programs want to run.
const TRIES_AT_ONCE: u32 = 20;

/// A file of counters, opened for reading.
#[derive(Debug)]
pub struct CounterView {
    mapping: PooledMapping,
    file: File,
    capacity: u32,
}

impl CounterView {
    /// Verifies a descriptor from another process, and maps it.
    ///
    /// # Errors
    ///
    /// See [`CounterError`]; the descriptor is closed then.
    //= SM2-CNT-004
    pub fn open(fd: OwnedFd) -> Result<Self, CounterError> {
        let file = InspectedFd::new(fd).map_err(failed("inspect"))?;
        let file = file.into_pooled()?;
        let size_bytes = file.size_bytes();
        let capacity = entries_in(size_bytes).ok_or(CounterError::Size { size_bytes })?;
        let mapping = PooledMapping::new(&file, size_bytes, false).map_err(failed("map"))?;
        let file = File::from(OwnedFd::from(file));
        let mut found = [0; ENTRY_BYTES as usize];
        files::read_exact_at(&file, &mut found, 0).map_err(failed("read"))?;
        let expected = header(capacity).map(u64::to_le_bytes);
        if found != *expected.as_flattened() {
            return Err(CounterError::Header);
        }
        Ok(Self {
            mapping,
            file,
            capacity,
        })
    }

    /// The number of entries that the file has room for; entry numbers are smaller.
    #[must_use]
    pub const fn capacity(&self) -> u32 {
        self.capacity
    }

    /// Copies entry `index`. `None` if it is not in use.
    ///
    /// Reading a hole of the file makes the kernel add a page of zeroes to it;
    /// [`entries`](Self::entries) skips holes.
    ///
    /// # Errors
    ///
    /// See [`Unreadable`].
    ///
    /// # Panics
    ///
    /// If there is no such entry.
    //= SM2-CNT-006
    pub fn read(&self, index: u32) -> Result<Option<Entry>, Unreadable> {
        let capacity = self.capacity;
        assert!(index < capacity, "entry {index} of {capacity}");
        let mut spare = TRIES;
        self.read_within(index, &mut spare)
    }

    /// As [`read`](Self::read), with at most `spare` attempts beyond the first.
    fn read_within(&self, index: u32, spare: &mut u32) -> Result<Option<Entry>, Unreadable> {
        let words = entry_words(self.mapping.words(), index);
        for tried in 1..=TRIES {
            match seqlock::copy(words) {
                Some(words) if words[field::TURN] == 0 => return Ok(None),
                Some(words) => {
                    let entry = Entry::from_words(&words);
                    return entry.map(Some).ok_or(Unreadable::Malformed);
                }
                None if *spare == 0 => break,
                None if tried < TRIES_AT_ONCE => hint::spin_loop(),
                None => thread::yield_now(),
            }
            *spare -= 1;
        }
        Err(Unreadable::Torn)
    }

    /// All entries in use, with their numbers, in ascending order.
    ///
    /// An entry that is allocated or freed meanwhile may be among them or not.
    #[must_use]
    pub const fn entries(&self) -> Entries<'_> {
        Entries {
            view: self,
            next: 0,
            end: 0,
            spare: TRIES_FOR_ALL,
        }
    }

    /// The first range of entries from `index` on that is not in a hole of the file: its first
    /// number, and the one after its last.
    fn written_from(&self, index: u32) -> Option<(u32, u32)> {
        let seek = |to: u64, whence| {
            let to = i64::try_from(to).map_err(|_| Errno::EINVAL)?;
            // All holders of this descriptor share the position, and none depends on it.
            files::seek(&self.file, to, whence).map(i64::cast_unsigned)
        };
        let offset = (u64::from(index) + 1) * ENTRY_BYTES;
        let extent = seek(offset, Whence::SeekData)
            .and_then(|start| Ok((start, seek(start, Whence::SeekHole)?)));
        match extent {
            Ok((start, end)) => {
                // A page boundary is an entry boundary.
                let entry_at = |offset: u64| u32::try_from(offset / ENTRY_BYTES).ok();
                let start = entry_at(start.max(offset))? - 1;
                let end = entry_at(end)?.saturating_sub(1).min(self.capacity);
                Some((start, end.max(start + 1)))
            }
            // The rest of the file is a hole.
            Err(Errno::ENXIO) => None,
            // Not expected of a memfd: read everything.
            Err(_) => Some((index, self.capacity)),
        }
    }
}

/// The entries of a [`CounterView`] that are in use.
#[derive(Clone, Debug)]
pub struct Entries<'a> {
    view: &'a CounterView,
    next: u32,
    /// The end of the current range without holes.
    end: u32,
    /// Remaining attempts beyond the first of each entry.
    spare: u32,
}

impl Iterator for Entries<'_> {
    type Item = (u32, Result<Entry, Unreadable>);

    fn next(&mut self) -> Option<Self::Item> {
        loop {
            if self.next >= self.end {
                if self.next >= self.view.capacity {
                    return None;
                }
                (self.next, self.end) = self.view.written_from(self.next)?;
            }
            let index = self.next;
            self.next += 1;
            if let Some(read) = self.view.read_within(index, &mut self.spare).transpose() {
                return Some((index, read));
            }
        }
    }
}

/// Why an entry cannot be read.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, thiserror::Error)]
pub enum Unreadable {
    /// The entry changed during each attempt, or its writer was stopped during a change.
    #[error("the entry changed during every attempt to read it: try again, or check its node")]
    Torn,
    /// The entry breaks SM2-CNT-005.
    #[error("the entry has a kind or fields that this version does not know")]
    Malformed,
}

/// Why a descriptor is not a file of counters.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum CounterError {
    /// The descriptor is not a memfd.
    #[error("counters: the descriptor is not a memfd")]
    NotAMemfd,
    /// Seals are missing: the author could shrink the file, or others could write to it.
    #[error("counters: the memfd has the seals {:#x}, and needs {:#x}", seals.0, Seals::POOLED.0)]
    Seals {
        /// The seals of the file.
        seals: Seals,
    },
    /// The size is not legal for a file of counters.
    #[error(
        "counters: a memfd of {size_bytes} bytes; it must be a multiple of 512 from 1,024 to 4,194,304"
    )]
    Size {
        /// The size.
        size_bytes: u64,
    },
    /// The header does not match this version and the size of the file.
    #[error("counters: the header is not that of a version 1 file of this size")]
    Header,
    /// The operating system refused.
    #[error("counters: cannot {action} the memfd: {source}")]
    Io {
        /// The operation that failed.
        action: &'static str,
        /// The error of the operating system.
        r#source: io::Error,
    },
}

impl From<VerifyError> for CounterError {
    fn from(error: VerifyError) -> Self {
        match error {
            VerifyError::NotAMemfd => Self::NotAMemfd,
            VerifyError::SealsMissing { seals, .. } => Self::Seals { seals },
        }
    }
}

fn failed(action: &'static str) -> impl FnOnce(io::Error) -> CounterError {
    move |source| CounterError::Io { action, source }
}

#[cfg(test)]
mod tests {
    use std::{mem, os::fd::AsFd};

    use sm2_proto::{Instant, InterfaceId};

    use super::*;
    use crate::CounterPage;

    /// Otherwise a file full of changes that do not end would hold up its reader.
    //= SM2-CNT-006 test
    #[test]
    fn each_attempt_beyond_the_first_is_taken_from_the_spare_ones() {
        let mut page = CounterPage::new().unwrap();
        let good = page.allocate(InterfaceId(1), None, Instant(0)).unwrap();
        let mut torn = page.allocate(InterfaceId(2), None, Instant(0)).unwrap();
        mem::forget(torn.update());
        let view = CounterView::open(page.as_fd().try_clone_to_owned().unwrap()).unwrap();
        let left = |index: u32, mut spare: u32| {
            let read = view.read_within(index, &mut spare);
            (read.map(|it| it.is_some()), spare)
        };
        for spare in [0, 1, 10, 3 * TRIES] {
            assert_eq!(left(good.index(), spare), (Ok(true), spare));
            assert_eq!(
                left(2, spare),
                (Ok(false), spare),
                "an entry that is not in use"
            );
            let used = spare.min(TRIES);
            let torn = left(torn.index(), spare);
            assert_eq!(torn, (Err(Unreadable::Torn), spare - used));
        }
        assert_eq!(view.entries().count(), 2);
    }
}
