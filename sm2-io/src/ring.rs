//! The file of a ring: words that two processes write (SPEC section 8.5).
//!
//! This module provides the memory and its atomic operations. The machine of [`sm2_proto::link`]
//! decides which words to write and which values to accept; it borrows a [`Ring`] as [`RingMemory`].

mod atomic;

use std::io;
use std::os::fd::{AsFd, BorrowedFd, OwnedFd};

use sm2_proto::Seals;
use sm2_proto::link::{At, CELL_WORDS, RingLayout, RingMemory};

use crate::mapping::writable::MappingMut;
use crate::memfd::RingFile;
use crate::memfd::file::{add_seals, create};
use crate::prefetch::prefetch_to_write;
use crate::sync::AtomicU64;

/// One side's mapping of a ring.
///
/// The other side can write any word at any time, but cannot make an access here fault: the size of
/// the file is sealed. (It can punch a page out of the file. If the machine is out of memory when
/// this side writes there again, the kernel kills this process as after any write to new memory.)
#[derive(Debug)]
pub struct Ring {
    mapping: MappingMut,
    layout: RingLayout,
}

impl Ring {
    /// Creates a ring of zeroes, and returns it with the descriptor for the other side.
    ///
    /// # Errors
    ///
    /// Any error of `memfd_create(2)`, `ftruncate(2)` and `mmap(2)`, such as too many descriptors or
    /// no memory.
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
    /// Any error of `mmap(2)`, among them `PermissionDenied` for a descriptor that is not open for
    /// writing. `InvalidInput` if the file is shorter than the layout.
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

    /// The first words of a cell behind its forward word.
    #[inline]
    fn cell(&self, index: u32, words: usize) -> &[AtomicU64] {
        assert!(words <= CELL_WORDS, "{words} words of a cell");
        let at = At::Forward(index);
        let offset = self.layout.offset(at).expect("a cell of the layout");
        let first = (offset / 8) as usize + 1;
        &self.mapping.words()[first..first + words]
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
    fn write_cell(&self, index: u32, words: &[u64]) {
        atomic::write(self.cell(index, words.len()), words);
    }

    #[inline]
    fn read_cell(&self, index: u32, words: &mut [u64]) {
        atomic::read(self.cell(index, words.len()), words);
    }

    #[inline]
    fn fence(&self) {
        atomic::order();
    }

    #[inline]
    fn prefetch(&self, at: At) {
        let word = std::ptr::from_ref(self.word(at)).cast::<u8>();
        prefetch_to_write(word);
        if let At::Forward(_) = at {
            // The second line of the cell.
            prefetch_to_write(word.wrapping_add(64));
        }
    }
}
