//! Private memory.

use std::io;
use std::ops::{Deref, DerefMut};

use crate::mapping::region::Region;

/// Private memory that starts as zeroes, and takes memory only for the pages that were written. For
/// large buffers whose users mostly need a small part: an allocator would clear recycled memory and
/// thereby make all its pages present. Dereferences to its bytes.
#[derive(Debug)]
pub struct Scratch {
    region: Region,
}

impl Scratch {
    /// Maps `len` bytes of zeroes.
    ///
    /// # Errors
    ///
    /// Any error of `mmap(2)`, such as no memory. `InvalidInput` for a length of 0.
    pub fn new(len: usize) -> io::Result<Self> {
        let region = Region::private(len)?;
        Ok(Self { region })
    }
}

impl Deref for Scratch {
    type Target = [u8];

    fn deref(&self) -> &[u8] {
        // SAFETY: the region is `len` readable, initialised bytes, and stays mapped while `self` is
        // borrowed. It is a private mapping: no other process writes to it, and a writer in this
        // process needs `deref_mut`, which borrows `self` exclusively.
        unsafe { std::slice::from_raw_parts(self.region.as_ptr(), self.region.len()) }
    }
}

impl DerefMut for Scratch {
    fn deref_mut(&mut self) -> &mut [u8] {
        // SAFETY: as in `deref`; the region is writable, and `self` is borrowed exclusively.
        unsafe { std::slice::from_raw_parts_mut(self.region.as_ptr(), self.region.len()) }
    }
}
