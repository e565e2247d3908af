//! Private memory.

use std::io;
use std::ops::{Deref, DerefMut};

use crate::mapping::region::Region;

/// Private memory, all zero at first, of which only those pages exist that were written: room for what
/// may be long and mostly is not. (An allocator clears what it had used before, and with that makes it
/// exist.) Dereferences to its bytes.
#[derive(Debug)]
pub struct Scratch {
    region: Region,
}

impl Scratch {
    /// So many bytes.
    ///
    /// # Errors
    ///
    /// Whatever `mmap(2)` says: no memory, or `InvalidInput` for a length of 0.
    pub fn new(len: usize) -> io::Result<Self> {
        let region = Region::private(len)?;
        Ok(Self { region })
    }
}

impl Deref for Scratch {
    type Target = [u8];

    fn deref(&self) -> &[u8] {
        // SAFETY: the region is `len` readable bytes, zero or what was written there, and stays
        // mapped while `self` is borrowed. It is private: nobody else writes, and who writes by
        // `deref_mut` has borrowed `self` exclusively.
        unsafe { std::slice::from_raw_parts(self.region.as_ptr(), self.region.len()) }
    }
}

impl DerefMut for Scratch {
    fn deref_mut(&mut self) -> &mut [u8] {
        // SAFETY: as in `deref`; the bytes are writable, and `self` is borrowed exclusively.
        unsafe { std::slice::from_raw_parts_mut(self.region.as_ptr(), self.region.len()) }
    }
}
