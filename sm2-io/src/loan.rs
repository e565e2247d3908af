//! A message that is written in place and then sealed.

use std::fs::File;
use std::io;
use std::os::fd::{AsFd, OwnedFd};

use sm2_proto::Seals;

use crate::mapping::{Mapping, MappingMut};
use crate::memfd::{add_seals, create, huge_pages_allowed, sealed_from_bytes};

/// A new memfd, mapped for writing in place, zeroed; [`seal`](Self::seal) makes
/// it a message. Dropping it instead frees the memory.
#[derive(Debug)]
pub struct SealedLoan {
    mapping: MappingMut,
    file: File,
}

impl SealedLoan {
    /// A loan of `len` bytes, all zero. From 2 MiB on the mapping starts at a
    /// multiple of 2 MiB and asks for huge pages where
    /// [they are allowed](crate::memfd::huge_pages_allowed).
    ///
    /// # Errors
    ///
    /// Whatever `memfd_create(2)`, `ftruncate(2)` and `mmap(2)` say: too many
    /// descriptors, no memory, a length that no file can have.
    pub fn new(len: u64) -> io::Result<Self> {
        let file = create(c"sm2-message", len)?;
        let mapping = MappingMut::new(file.as_fd(), len, huge_pages_allowed())?;
        // A child process would inherit the writable mapping, and while it exists the
        // kernel refuses F_SEAL_WRITE: a fork on another thread must not fail us.
        mapping.keep_from_children()?;
        Ok(Self { mapping, file })
    }

    /// The length in bytes.
    #[must_use]
    pub const fn len(&self) -> usize {
        self.mapping.len()
    }

    /// Whether the length is 0.
    #[must_use]
    pub const fn is_empty(&self) -> bool {
        self.mapping.len() == 0
    }

    /// What was written so far.
    #[must_use]
    pub const fn as_slice(&self) -> &[u8] {
        // SAFETY: the mapping is `len` readable bytes of a memfd that this value created and
        // has shown to nobody, so nobody else can write; it lives as long as `self`.
        unsafe { std::slice::from_raw_parts(self.mapping.as_ptr(), self.mapping.len()) }
    }

    /// Where to write.
    #[must_use]
    pub const fn as_mut_slice(&mut self) -> &mut [u8] {
        // SAFETY: as in `as_slice`, and `self` is borrowed exclusively.
        unsafe { std::slice::from_raw_parts_mut(self.mapping.as_ptr(), self.mapping.len()) }
    }

    /// Ends the writing for good: nobody can change the bytes or the size any more.
    ///
    /// While the kernel holds on to pages (`EBUSY`), which others on the machine can
    /// cause, the bytes are copied into new memory instead, which was never mapped.
    ///
    /// # Errors
    ///
    /// Whatever `memfd_create(2)` and `pwrite(2)` say of that copy. The message is lost
    /// then.
    pub fn seal(self) -> io::Result<OwnedFd> {
        let Self { mapping, file } = self;
        let len = mapping.len() as u64;
        // F_SEAL_WRITE is refused while a writable mapping exists.
        drop(mapping);
        match add_seals(&file, Seals::SEALED) {
            Ok(()) => Ok(file.into()),
            Err(error) if error.kind() == io::ErrorKind::ResourceBusy => {
                let written = Mapping::read_only(file.as_fd(), len, false)?;
                sealed_from_bytes(written.as_slice())
            }
            Err(error) => Err(error),
        }
    }
}
