//! A message that is written in place and then sealed.

use std::fs::File;
use std::io::{self, IoSlice};
use std::os::fd::{AsFd, OwnedFd};

use sm2_proto::Seals;

use super::copy::sealed_from_parts;
use super::file::{create, try_seals};
use crate::huge::{HUGE_LEAST_BYTES, HUGE_PAGE_BYTES, huge_pages_allowed};
use crate::mapping::writable::MappingMut;

/// A new memfd, mapped for writing in place, zeroed; [`seal`](Self::seal) makes
/// it a message. Dropping it instead frees the memory.
#[derive(Debug)]
pub struct SealedLoan {
    mapping: MappingMut,
    file: File,
    len: usize,
    /// The mapping may be of more than the message.
    pages: Pages,
}

/// What the memory of a loan is made of.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Pages {
    Small,
    Huge,
}

impl SealedLoan {
    /// A loan of `len` bytes, all zero. From 512 KiB on it is made of huge pages where
    /// there are some.
    ///
    /// # Errors
    ///
    /// Whatever `memfd_create(2)`, `ftruncate(2)` and `mmap(2)` say: too many
    /// descriptors, no memory, a length that no file can have.
    pub fn new(len: u64) -> io::Result<Self> {
        let size = usize::try_from(len).map_err(|_| io::ErrorKind::InvalidInput)?;
        if let Some(loan) = Self::of_huge_pages(size)? {
            return Ok(loan);
        }
        let file = create(c"sm2-message", len)?;
        let mapping = MappingMut::new(file.as_fd(), len, huge_pages_allowed())?;
        Self::of(file, mapping, size, Pages::Small)
    }

    /// A loan of `len` bytes, present in huge pages, if it is large and there are some.
    pub(crate) fn of_huge_pages(len: usize) -> io::Result<Option<Self>> {
        if len < HUGE_LEAST_BYTES {
            return Ok(None);
        }
        let file = create(c"sm2-message", len as u64)?;
        match MappingMut::of_huge_pages(file.as_fd(), len as u64)? {
            Some(mapping) => Self::of(file, mapping, len, Pages::Huge).map(Some),
            None => Ok(None),
        }
    }

    pub(crate) fn of(
        file: File,
        mapping: MappingMut,
        len: usize,
        pages: Pages,
    ) -> io::Result<Self> {
        assert!(len <= mapping.len());
        // A child process would inherit the writable mapping, and while it exists the
        // kernel refuses F_SEAL_WRITE: a fork on another thread must not fail us.
        mapping.keep_from_children()?;
        Ok(Self {
            mapping,
            file,
            len,
            pages,
        })
    }

    /// The length in bytes.
    #[must_use]
    pub const fn len(&self) -> usize {
        self.len
    }

    /// Whether the length is 0.
    #[must_use]
    pub const fn is_empty(&self) -> bool {
        self.len == 0
    }

    /// What was written so far.
    #[must_use]
    pub const fn as_slice(&self) -> &[u8] {
        // SAFETY: the mapping is `len` readable bytes, or more, of a memfd that this value's
        // maker created and has shown to nobody, so nobody else can write; it lives as long
        // as `self`.
        unsafe { std::slice::from_raw_parts(self.mapping.as_ptr(), self.len) }
    }

    /// Where to write.
    #[must_use]
    pub const fn as_mut_slice(&mut self) -> &mut [u8] {
        // SAFETY: as in `as_slice`, and `self` is borrowed exclusively.
        unsafe { std::slice::from_raw_parts_mut(self.mapping.as_ptr(), self.len) }
    }

    /// The same memory for a message of `len` bytes, which is no longer than it was.
    pub(crate) fn shortened(mut self, len: usize) -> Self {
        assert!(len <= self.len);
        self.len = len;
        self
    }

    /// Sealed with a copy of `bytes`, which are as long as the loan.
    pub(crate) fn filled(mut self, bytes: &[u8]) -> io::Result<OwnedFd> {
        self.as_mut_slice().copy_from_slice(bytes);
        self.seal()
    }

    /// Ends the writing for good: nobody can change the bytes or the size any more.
    ///
    /// While the kernel holds on to pages (`EBUSY`), which others on the machine can
    /// cause, the bytes are copied into new memory instead, which was never mapped. The
    /// kernel waits for 150 ms before it says so, and is asked once.
    ///
    /// # Errors
    ///
    /// Whatever `memfd_create(2)` and `pwrite(2)` say of that copy. The message is lost
    /// then.
    pub fn seal(self) -> io::Result<OwnedFd> {
        let Self {
            mapping,
            file,
            len,
            pages,
        } = self;
        // What the message does not need goes, but no huge page is split for that: a
        // sealed file may be longer than its message (SM2-SEG-002).
        let needed = match pages {
            Pages::Small => len,
            Pages::Huge => len.next_multiple_of(HUGE_PAGE_BYTES),
        };
        let surplus = needed < mapping.len();
        // F_SEAL_WRITE is refused while a writable mapping exists.
        drop(mapping);
        if surplus {
            file.set_len(needed as u64)?;
        }
        match try_seals(&file, Seals::SEALED) {
            Ok(()) => Ok(file.into()),
            Err(error) if error.kind() == io::ErrorKind::ResourceBusy => {
                // Still nobody else's: mapped again, it is a loan again.
                let mapping = MappingMut::new(file.as_fd(), len as u64, false)?;
                let written = Self::of(file, mapping, len, pages)?;
                sealed_from_parts(&[IoSlice::new(written.as_slice())])
            }
            Err(error) => Err(error),
        }
    }
}
