//! Appending to the file.

use std::io;

use crate::storage::{BLOCK_BYTES, Storage};

/// Appends bytes to a file. Short parts wait until they are [written](Self::flush) together.
pub(super) struct Appender {
    storage: Box<dyn Storage>,
    /// The place of the first byte that waits.
    offset: u64,
    waiting: Vec<u8>,
}

impl Appender {
    pub(super) fn new(storage: Box<dyn Storage>) -> Self {
        Self {
            storage,
            offset: 0,
            waiting: Vec::new(),
        }
    }

    /// The place of the next byte.
    pub(super) fn end(&self) -> u64 {
        self.offset + self.waiting.len() as u64
    }

    pub(super) fn free_bytes(&self) -> io::Result<Option<u64>> {
        self.storage.free_bytes()
    }

    /// Appends a short part.
    pub(super) fn append(&mut self, bytes: &[u8]) {
        self.waiting.extend_from_slice(bytes);
    }

    /// Appends a long part without a copy. Its whole blocks bypass the page cache if it begins with a block, both in
    /// memory and in the file.
    pub(super) fn append_long(&mut self, bytes: &[u8]) -> io::Result<()> {
        self.flush()?;
        let is_aligned = self.offset.is_multiple_of(BLOCK_BYTES as u64)
            && bytes.as_ptr().addr().is_multiple_of(BLOCK_BYTES);
        let whole = match is_aligned {
            true => bytes.len() - bytes.len() % BLOCK_BYTES,
            false => 0,
        };
        // The slot of a message has foreign bytes behind its payload: the last block is not written as a whole.
        let (blocks, rest) = bytes.split_at(whole);
        if !blocks.is_empty() {
            self.storage.write_blocks_at(blocks, self.offset)?;
            self.offset += blocks.len() as u64;
        }
        if rest.len() < BLOCK_BYTES {
            self.append(rest);
            return Ok(());
        }
        self.storage.write_at(rest, self.offset)?;
        self.offset += rest.len() as u64;
        Ok(())
    }

    /// Writes the short parts.
    pub(super) fn flush(&mut self) -> io::Result<()> {
        if !self.waiting.is_empty() {
            self.storage.write_at(&self.waiting, self.offset)?;
            self.offset = self.end();
            self.waiting.clear();
        }
        Ok(())
    }

    /// Writes everything to the disk.
    pub(super) fn sync(&mut self) -> io::Result<()> {
        self.flush()?;
        self.storage.sync()
    }
}
