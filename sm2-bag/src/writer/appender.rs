//! Appending to the file.

use std::io;

use sm2_node::Sample;

use super::disk::{Disk, Done, MessageWrite};
use crate::storage::{BLOCK_BYTES, Storage};

/// Appends bytes to a file. Short parts wait until they are [written](Self::flush) together.
///
/// A later call returns the error of a write.
pub(super) struct Appender {
    disk: Disk,
    /// The place of the first byte that waits.
    offset: u64,
    waiting: Vec<u8>,
}

impl Appender {
    pub(super) fn start(storage: Box<dyn Storage>) -> io::Result<Self> {
        Ok(Self {
            disk: Disk::start(storage)?,
            offset: 0,
            waiting: Vec::new(),
        })
    }

    /// The place of the next byte.
    pub(super) fn end(&self) -> u64 {
        self.offset + self.waiting.len() as u64
    }

    pub(super) fn free_bytes(&mut self) -> io::Result<Option<u64>> {
        self.disk.free_bytes()
    }

    /// Appends a short part.
    pub(super) fn append(&mut self, bytes: &[u8]) {
        self.waiting.extend_from_slice(bytes);
    }

    /// Appends a long message without a copy. Its whole blocks bypass the page cache if it begins with a block, both in
    /// memory and in the file.
    pub(super) fn append_long(&mut self, message: Sample<[u8]>, done: Done) -> io::Result<()> {
        self.flush()?;
        let is_aligned = self.offset.is_multiple_of(BLOCK_BYTES as u64)
            && message.as_ptr().addr().is_multiple_of(BLOCK_BYTES);
        // The slot of a message has foreign bytes behind its payload: the last block is not written as a whole.
        let whole = message.len() - message.len() % BLOCK_BYTES;
        let len_bytes = match is_aligned {
            true => whole,
            false => message.len(),
        };
        let offset = self.offset;
        self.offset += len_bytes as u64;
        self.append(&message[len_bytes..]);
        self.disk.write_message(MessageWrite {
            message,
            len_bytes,
            offset,
            has_whole_blocks: is_aligned,
            done,
        })
    }

    /// Writes the short parts.
    pub(super) fn flush(&mut self) -> io::Result<()> {
        if !self.waiting.is_empty() {
            let offset = self.offset;
            self.offset = self.end();
            self.disk.write(std::mem::take(&mut self.waiting), offset)?;
        }
        Ok(())
    }

    /// Writes everything to the disk.
    pub(super) fn sync(&mut self) -> io::Result<()> {
        self.flush()?;
        self.disk.sync()
    }

    /// Begins to write everything to the disk that was appended so far.
    pub(super) fn begin_sync(&mut self) -> io::Result<()> {
        self.flush()?;
        self.disk.begin_sync()
    }

    /// Waits until everything is on the disk that was appended before [`begin_sync`](Self::begin_sync).
    pub(super) fn end_sync(&mut self) -> io::Result<()> {
        self.disk.end_sync()
    }
}
