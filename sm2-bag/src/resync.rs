//! Finding the first record behind a damaged one.
//!
//! A wrong byte may be in the length of a record, so it is not certain where a damaged record ends. If records follow
//! where it says that it ends, it is believed. A chunk says it twice, and the nearer place comes first. Otherwise the
//! file is searched, byte by byte, for a chunk whose checksum is right, and for the end of the data. A chunk without a
//! checksum is not found in this way. A payload that is an MCAP file itself has such chunks, too: they can be taken for
//! those of the bag if the length before them is damaged.

use std::fs::File;
use std::os::unix::fs::FileExt;

use mcap::McapResult;
use mcap::records::op;

use crate::chunk::{
    CHUNK_SHAPE_BYTES, RECORD_HEAD_BYTES, RecordReader, chunk_len, chunk_len_by_content, of_read,
};

/// So many records that follow each other show that the first one begins where it seems to begin.
const CREDIBLE_RECORDS: usize = 4;
/// How many bytes of the file are searched at a time.
const WINDOW_BYTES: usize = 1 << 20;
/// How often the length of the file is read at most to verify what looks like a chunk. A hostile file has many of them,
/// each inside of the one before.
const READS_MAX: u64 = 4;
/// The record that ends the data, up to its checksum.
const DATA_END: [u8; RECORD_HEAD_BYTES] = [op::DATA_END, 4, 0, 0, 0, 0, 0, 0, 0];

/// The record before a place.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Behind {
    Chunk,
    Any,
}

/// Finds records behind damaged ones.
pub(crate) struct Resync<'a> {
    file: &'a File,
    /// The length of the file.
    end: u64,
    /// How many bytes may still be read to verify chunks.
    left: u64,
}

impl<'a> Resync<'a> {
    /// For a file of `end` bytes.
    pub(crate) const fn new(file: &'a File, end: u64) -> Self {
        Self {
            file,
            end,
            left: end.saturating_mul(READS_MAX),
        }
    }

    /// The place of the first record behind the damaged one at `offset`, which says that it has this length, if it fits
    /// into the file. `None` if nothing behind it can be read. The place can be before `offset`, but not before `from`:
    /// the length of a record in between may be the damage.
    ///
    /// # Errors
    ///
    /// An error of the operating system.
    pub(crate) fn behind(
        &mut self,
        from: u64,
        offset: u64,
        len_bytes: Option<u64>,
    ) -> McapResult<Option<u64>> {
        let said = len_bytes.map(|len| offset.saturating_add(len));
        let by_content = self.end_by_content(offset)?;
        // A wrong length can end at a record by chance, and hide those before it.
        let nearer = by_content.filter(|it| said.is_none_or(|said| *it < said));
        if let Some(next) = nearer.filter(|it| self.is_credible(*it, Behind::Chunk)) {
            return Ok(Some(next));
        }
        match said.filter(|it| self.is_credible(*it, Behind::Any)) {
            Some(next) => Ok(Some(next)),
            None => self.search(from, offset),
        }
    }

    /// Where the chunk at `offset` ends by the length of its content.
    fn end_by_content(&self, offset: u64) -> McapResult<Option<u64>> {
        let mut head = [0; CHUNK_SHAPE_BYTES];
        let len = (self.end.saturating_sub(offset)).min(head.len() as u64) as usize;
        of_read(self.file.read_exact_at(&mut head[..len], offset))?;
        let len_bytes = chunk_len_by_content(&head[..len]);
        let end = len_bytes.and_then(|it| offset.checked_add(it));
        Ok(end.filter(|it| *it < self.end))
    }

    /// Whether records follow each other from this place on, which is behind such a record.
    fn is_credible(&self, offset: u64, behind: Behind) -> bool {
        let mut reader = RecordReader::new(self.file, offset, self.end);
        for _ in 0..CREDIBLE_RECORDS {
            match reader.next() {
                Ok(Some(record)) if record.is_data_end() => return true,
                // It may be one of the chunk itself, whose checksum is wrong.
                Ok(Some(record)) if record.opcode == op::MESSAGE && behind == Behind::Chunk => {
                    return false;
                }
                Ok(Some(record)) if record.verify().is_ok() => {
                    if record.opcode == op::CHUNK {
                        return true;
                    }
                }
                Ok(_) | Err(_) => return false,
            }
        }
        true
    }

    /// The place of the first chunk with a right checksum, or of the end of the data, from `from` on, but not at
    /// `damaged`.
    fn search(&mut self, from: u64, damaged: u64) -> McapResult<Option<u64>> {
        let mut window = vec![0; WINDOW_BYTES + CHUNK_SHAPE_BYTES];
        let mut start = from;
        while start < self.end {
            let len = (self.end - start).min(window.len() as u64) as usize;
            let bytes = &mut window[..len];
            of_read(self.file.read_exact_at(bytes, start))?;
            for at in 0..len.min(WINDOW_BYTES) {
                let place = start + at as u64;
                let here = &bytes[at..];
                if place == damaged {
                    continue;
                }
                if here.starts_with(&DATA_END) {
                    return Ok(Some(place));
                }
                let Some(chunk_len) = chunk_len(here, self.end - place) else {
                    continue;
                };
                let Some(left) = self.left.checked_sub(chunk_len) else {
                    return Ok(None);
                };
                self.left = left;
                let record = RecordReader::new(self.file, place, self.end).next()?;
                if record.is_some_and(|it| it.verify().is_ok()) {
                    return Ok(Some(place));
                }
            }
            start += WINDOW_BYTES as u64;
        }
        Ok(None)
    }
}
