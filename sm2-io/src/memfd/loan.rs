//! Messages that are written in place and then sealed.

use std::fs::File;
use std::io::{self, IoSlice};
use std::os::fd::{AsFd, OwnedFd};

use sm2_proto::Seals;

use super::copy::sealed_from_parts;
use super::file::{create, try_seals};
use crate::huge::{HUGE_LEAST_BYTES, HUGE_PAGE_BYTES, huge_pages_allowed};
use crate::mapping::writable::MappingMut;
use crate::syscall::files;

/// A new memfd of zeroes that is mapped for writing. [`seal`](Self::seal) makes it a message; dropping
/// it frees the memory.
#[derive(Debug)]
pub struct SealedLoan {
    mapping: MappingMut,
    file: File,
    len: usize,
    /// The mapping may be longer than the message.
    pages: Pages,
}

/// The pages of a loan.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Pages {
    Small,
    Huge,
}

impl SealedLoan {
    /// Creates a loan of `len` zeroes, in huge pages from 512 KiB on if the kernel has them.
    ///
    /// # Errors
    ///
    /// Any error of `memfd_create(2)`, `ftruncate(2)` and `mmap(2)`, such as too many descriptors,
    /// no memory, or a length that no file can have.
    pub fn new(len: u64) -> io::Result<Self> {
        let size = usize::try_from(len).map_err(|_| io::ErrorKind::InvalidInput)?;
        if let Some(loan) = Self::of_huge_pages(size)? {
            return Ok(loan);
        }
        let file = create(c"sm2-message", len)?;
        let mapping = MappingMut::new(file.as_fd(), len, huge_pages_allowed())?;
        Self::of(file, mapping, size, Pages::Small)
    }

    /// Creates a loan of `len` bytes that are present in huge pages; `None` if it is too short or
    /// the kernel has no huge pages.
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
        // A child process would inherit the writable mapping, and the kernel refuses F_SEAL_WRITE
        // while one exists: a fork on another thread must not break sealing.
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

    /// The bytes of the message.
    #[must_use]
    pub const fn as_slice(&self) -> &[u8] {
        // SAFETY: the mapping has at least `len` readable bytes (`of` asserts that) and lives as long
        // as `self`. The file is a memfd that this crate created and whose descriptor it gives out
        // only after sealing (`seal`), when this value is gone: so no other process can write to the
        // bytes or shrink the file.
        unsafe { std::slice::from_raw_parts(self.mapping.as_ptr(), self.len) }
    }

    /// The bytes of the message, for writing.
    #[must_use]
    pub const fn as_mut_slice(&mut self) -> &mut [u8] {
        // SAFETY: as in `as_slice`, and `self` is borrowed exclusively.
        unsafe { std::slice::from_raw_parts_mut(self.mapping.as_ptr(), self.len) }
    }

    /// The same memory for a message of `len` bytes, which must not be longer than the loan.
    pub(crate) fn shortened(mut self, len: usize) -> Self {
        assert!(len <= self.len);
        self.len = len;
        self
    }

    /// Copies `bytes`, which must be as long as the loan, and seals the loan.
    pub(crate) fn filled(mut self, bytes: &[u8]) -> io::Result<OwnedFd> {
        self.as_mut_slice().copy_from_slice(bytes);
        self.seal()
    }

    /// Seals the message: no process can change its bytes or its size any more.
    ///
    /// The kernel refuses (`EBUSY`, after 150 ms) while something holds a reference to a page, which
    /// other programs on the machine can cause. The bytes are then copied into a new file that was never
    /// mapped, without a second attempt.
    ///
    /// # Errors
    ///
    /// Any error of `memfd_create(2)` and `pwrite(2)` for that copy. The message is lost then.
    pub fn seal(self) -> io::Result<OwnedFd> {
        let Self {
            mapping,
            file,
            len,
            pages,
        } = self;
        // Frees the pages that the message does not need without splitting a huge page: a sealed file
        // may be longer than its message (SM2-SEG-002).
        let needed = match pages {
            Pages::Small => len,
            Pages::Huge => len.next_multiple_of(HUGE_PAGE_BYTES),
        };
        let surplus = needed < mapping.len();
        // The kernel refuses F_SEAL_WRITE while a writable mapping exists.
        drop(mapping);
        if surplus {
            files::set_len(&file, needed as u64)?;
        }
        match try_seals(&file, Seals::SEALED) {
            Ok(()) => Ok(file.into()),
            Err(error) if error.kind() == io::ErrorKind::ResourceBusy => {
                // No other process has the file yet: mapped again, it is a loan again.
                let mapping = MappingMut::new(file.as_fd(), len as u64, false)?;
                let written = Self::of(file, mapping, len, pages)?;
                sealed_from_parts(&[IoSlice::new(written.as_slice())])
            }
            Err(error) => Err(error),
        }
    }
}
