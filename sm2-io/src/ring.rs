//! The file of a ring: words that two processes write (SPEC section 8.5).
//!
//! Here are the memory and its atomic operations. What is written where, and what is believed of
//! what is read, is decided by [`sm2_proto::link`], to which a [`Ring`] is lent as [`RingMemory`].

mod atomic;

use std::io;
use std::os::fd::{AsFd, BorrowedFd, OwnedFd};

use sm2_proto::Seals;
use sm2_proto::link::{At, RingLayout, RingMemory};

use crate::mapping::writable::MappingMut;
use crate::memfd::RingFile;
use crate::memfd::file::{add_seals, create};
use crate::sync::AtomicU64;

/// One side's mapping of a ring.
///
/// The other side can write any of its words at any time, and can make no access here fault: the
/// size of the file is sealed. (If the machine is out of memory, a page that it punched out may
/// not come back; then this process is killed as after any other write to new memory.)
#[derive(Debug)]
pub struct Ring {
    mapping: MappingMut,
    layout: RingLayout,
}

impl Ring {
    /// A new ring, all zero, and the descriptor to hand to the other side.
    ///
    /// # Errors
    ///
    /// Whatever `memfd_create(2)`, `ftruncate(2)` and `mmap(2)` say: too many
    /// descriptors, no memory.
    //= SM2-RNG-002
    pub fn create(layout: RingLayout) -> io::Result<(Self, OwnedFd)> {
        let file = create(c"sm2-ring", layout.size_bytes())?;
        add_seals(&file, Seals::RING)?;
        let ring = Self::map_checked(file.as_fd(), layout)?;
        Ok((ring, file.into()))
    }

    /// Maps a ring that came from the other side.
    ///
    /// # Errors
    ///
    /// Whatever `mmap(2)` says, among them `PermissionDenied` for a descriptor that is not open
    /// for writing. `InvalidInput` if the file is shorter than the layout.
    pub fn map(file: &RingFile, layout: RingLayout) -> io::Result<Self> {
        if file.size_bytes() < layout.size_bytes() {
            return Err(io::ErrorKind::InvalidInput.into());
        }
        Self::map_checked(file.as_fd(), layout)
    }

    /// Maps a file that cannot become shorter than the layout.
    fn map_checked(fd: BorrowedFd<'_>, layout: RingLayout) -> io::Result<Self> {
        let mapping = MappingMut::new(fd, layout.size_bytes(), false)?;
        Ok(Self { mapping, layout })
    }

    #[inline]
    fn word(&self, at: At) -> &AtomicU64 {
        let offset = self.layout.offset(at).expect("a word of the layout");
        &self.mapping.words()[(offset / 8) as usize]
    }
}

impl RingMemory for Ring {
    #[inline]
    fn load(&self, at: At) -> u64 {
        atomic::load(self.word(at))
    }

    #[inline]
    fn swap(&self, at: At, bits: u64) -> u64 {
        atomic::swap(self.word(at), bits)
    }

    #[inline]
    fn take(&self, at: At, bits: u64) -> bool {
        atomic::take(self.word(at), bits)
    }

    #[inline]
    fn fence(&self) {
        atomic::order();
    }
}
