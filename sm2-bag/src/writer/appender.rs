//! Appending to the file.

use std::io;
use std::ops::Deref;

use crc32fast::Hasher;
use sm2_node::Sample;

use super::disk::{Disk, Done};
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

/// A long message.
pub(crate) enum LongMessage {
    /// In the slot of its publisher.
    Held(Sample<[u8]>),
    /// A copy.
    Owned(Vec<u8>),
}

impl Deref for LongMessage {
    type Target = [u8];

    fn deref(&self) -> &[u8] {
        match self {
            Self::Held(it) => it,
            Self::Owned(it) => it,
        }
    }
}

/// A long payload that begins behind the end of the file. Its whole blocks are on their way to the disk.
pub(super) struct WrittenAhead {
    /// The CRC-32 of the payload as it will be in the file.
    pub(super) crc: u32,
    /// The place behind the last whole block.
    end: u64,
    /// The rest of the payload.
    tail: Vec<u8>,
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

    /// Writes the whole blocks of a message to `offset`, a multiple of [`BLOCK_BYTES`] behind the [end](Self::end). The
    /// caller appends everything up to `offset`, and then the [rest](Self::append_written).
    ///
    /// The publisher of the message may still be able to change it. So each byte is read once, into memory that no
    /// other process can change, and both the checksum and the disk get the copy.
    pub(super) fn write_ahead(
        &mut self,
        message: LongMessage,
        offset: u64,
        done: Done,
    ) -> io::Result<WrittenAhead> {
        let (mut blocks, tail) = message.split_at(message.len() - message.len() % BLOCK_BYTES);
        let end = offset + blocks.len() as u64;
        let mut crc = Hasher::new();
        while !blocks.is_empty() {
            let mut buffer = self.disk.buffer()?;
            let len_bytes = buffer.fill(blocks, &mut crc);
            let offset = end - blocks.len() as u64;
            self.disk.write_blocks(buffer, len_bytes, offset)?;
            blocks = &blocks[len_bytes..];
        }
        let tail = tail.to_vec();
        crc.update(&tail);
        // The publisher gets its slot back before the message counts as written.
        drop(message);
        self.disk.then(done)?;
        Ok(WrittenAhead {
            crc: crc.finalize(),
            end,
            tail,
        })
    }

    /// Appends a payload whose whole blocks [`write_ahead`](Self::write_ahead) has written.
    pub(super) fn append_written(&mut self, payload: WrittenAhead) -> io::Result<()> {
        self.flush()?;
        self.offset = payload.end;
        self.waiting = payload.tail;
        Ok(())
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
