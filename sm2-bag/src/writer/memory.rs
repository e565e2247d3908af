//! The records of the MCAP writer, before they are in the file.

use std::io::{self, Cursor, Seek, SeekFrom, Write};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

/// Memory that the MCAP writer owns, and that its user can take. Its positions are those of the file.
#[derive(Clone, Debug, Default)]
pub(super) struct Memory(Arc<Mutex<Part>>);

/// A part of the file.
#[derive(Debug, Default)]
struct Part {
    /// The place of its first byte in the file.
    offset: u64,
    bytes: Cursor<Vec<u8>>,
}

impl Memory {
    fn lock(&self) -> MutexGuard<'_, Part> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Takes the bytes out of the memory. The MCAP writer must have ended its chunk.
    pub(super) fn take(&self) -> Vec<u8> {
        let mut part = self.lock();
        let bytes = std::mem::take(&mut part.bytes).into_inner();
        part.offset += bytes.len() as u64;
        bytes
    }

    /// Puts the next bytes at `offset`. The memory must be empty.
    pub(super) fn set_offset(&self, offset: u64) {
        self.lock().offset = offset;
    }
}

impl Write for Memory {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        self.lock().bytes.write(bytes)
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

impl Seek for Memory {
    fn seek(&mut self, to: SeekFrom) -> io::Result<u64> {
        let mut part = self.lock();
        let to = match to {
            SeekFrom::Start(at) => {
                let inside = at.checked_sub(part.offset);
                SeekFrom::Start(inside.ok_or(io::ErrorKind::InvalidInput)?)
            }
            relative => relative,
        };
        Ok(part.offset + part.bytes.seek(to)?)
    }
}
