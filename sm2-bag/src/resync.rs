//! Finding the first record behind a damaged one.
//!
//! A wrong byte may be in the length of a record, so it is not certain where a damaged record ends. If records follow
//! where it says that it ends, it is believed. A chunk says it twice, and the nearer place comes first. Otherwise the
//! file is searched, byte by byte, for a chunk whose checksum is right, and for the end of the data. A chunk without a
//! checksum is not found in this way. A payload that is an MCAP file itself has such chunks, too: they can be taken for
//! those of the bag if the length before them is damaged.
//!
//! A wrong length can also end at a record, at one inside of a chunk as well: everything before that record would be
//! missing in silence. A record without a checksum is therefore compared with the summary, and with the length of its
//! fields. It is damaged as well if a chunk whose checksum is right begins inside of it.

use std::fs::File;
use std::os::unix::fs::FileExt;

use mcap::McapResult;
use mcap::records::op;

use crate::chunk::{
    CHUNK_SHAPE_BYTES, PRIVATE, RECORD_HEAD_BYTES, RawRecord, RecordReader, chunk_len,
    chunk_len_by_content, of_read,
};
use crate::error::is_of_system;
use crate::landmarks::Landmarks;

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

/// A record that cannot be read.
#[derive(Clone, Copy)]
pub(crate) struct Unreadable {
    /// Its place in the file, in bytes.
    pub(crate) offset: u64,
    /// Its length as it says, if it fits into the file and can be believed.
    pub(crate) len_bytes: Option<u64>,
    /// Its length by its fields, if they say where they end.
    pub(crate) fields_len_bytes: Option<u64>,
}

/// Finds records behind damaged ones.
pub(crate) struct Resync<'a> {
    file: &'a File,
    /// The length of the file.
    end: u64,
    landmarks: Landmarks,
    /// How many bytes may still be read to verify chunks and landmarks.
    left: u64,
}

impl<'a> Resync<'a> {
    /// For a file of `end` bytes.
    pub(crate) const fn new(file: &'a File, end: u64, landmarks: Landmarks) -> Self {
        Self {
            file,
            end,
            landmarks,
            left: end.saturating_mul(READS_MAX),
        }
    }

    /// Whether a record, which could be read, has a wrong length or a wrong opcode: the summary names another record at
    /// its place, or it has others in it. A record whose length is checked has none, whatever a summary says.
    ///
    /// # Errors
    ///
    /// An error of the operating system.
    pub(crate) fn is_wrong(&mut self, record: &RawRecord) -> McapResult<Option<Unreadable>> {
        if record.has_checked_length() {
            return Ok(None);
        }
        let offset = record.offset;
        let end = offset + record.len_bytes();
        let unreadable = |len_bytes, fields_len_bytes| {
            Ok(Some(Unreadable {
                offset,
                len_bytes,
                fields_len_bytes,
            }))
        };
        if let Some(named) = self.landmarks.at(offset)
            && !named.is(record)
        {
            return unreadable(Some(named.len_bytes), None);
        }
        let behind_fields = record.behind_fields();
        if behind_fields.is_some_and(<[u8]>::is_empty) {
            // Both of its lengths are the same.
            return Ok(None);
        }
        let fields_end = behind_fields.map(|it| end - it.len() as u64);
        if let Some(fields_end) = fields_end
            && (record.opcode == op::MESSAGE_INDEX || self.may_begin_record(fields_end)?)
        {
            return unreadable(None, Some(fields_end - offset));
        }
        let is_hidden = self.named_between(offset, end)?.is_some()
            || record.opcode != op::MESSAGE && self.chunk_inside(record)?;
        match is_hidden {
            true => unreadable(None, None),
            false => Ok(None),
        }
    }

    /// Whether the bytes at this place can be the head of a record.
    fn may_begin_record(&self, offset: u64) -> McapResult<bool> {
        let head_bytes = RECORD_HEAD_BYTES as u64;
        let Some(left) = self.end.saturating_sub(offset).checked_sub(head_bytes) else {
            return Ok(false);
        };
        let mut head = [0; RECORD_HEAD_BYTES];
        of_read(self.file.read_exact_at(&mut head, offset))?;
        let [opcode, len @ ..] = head;
        let is_of_data = matches!(opcode, op::HEADER..=op::DATA_END | PRIVATE..);
        Ok(is_of_data && u64::from_le_bytes(len) <= left)
    }

    /// Whether a chunk with a right checksum begins inside of a record.
    fn chunk_inside(&mut self, record: &RawRecord) -> McapResult<bool> {
        let inside = record.bytes().iter().enumerate().skip(RECORD_HEAD_BYTES);
        for (at, _) in inside.filter(|it| *it.1 == op::CHUNK) {
            let place = record.offset + at as u64;
            let mut head = [0; CHUNK_SHAPE_BYTES];
            let len = (self.end - place).min(head.len() as u64) as usize;
            let whole = record.bytes()[at..].first_chunk();
            match whole {
                Some(it) => head = *it,
                None => of_read(self.file.read_exact_at(&mut head[..len], place))?,
            }
            if self.is_chunk(&head[..len], place)? {
                return Ok(true);
            }
        }
        Ok(false)
    }

    /// The place of the first record between two places that the summary names and that can be read.
    fn named_between(&mut self, from: u64, to: u64) -> McapResult<Option<u64>> {
        for it in self.landmarks.behind(from) {
            if it.offset >= to {
                break;
            }
            let Some(left) = self.left.checked_sub(it.len_bytes) else {
                break;
            };
            self.left = left;
            match RecordReader::new(self.file, it.offset, self.end).next() {
                Ok(Some(record)) if it.is(&record) => return Ok(Some(it.offset)),
                Err(error) if is_of_system(&error) => return Err(error),
                Ok(_) | Err(_) => {}
            }
        }
        Ok(None)
    }

    /// The place of the first record behind a damaged one. `None` if nothing behind it can be read. The place can be
    /// before the damaged record, but not before `from`: the length of a record in between may be the damage.
    ///
    /// # Errors
    ///
    /// An error of the operating system.
    pub(crate) fn behind(&mut self, from: u64, damaged: Unreadable) -> McapResult<Option<u64>> {
        let found = self.found_behind(from, damaged)?;
        let named = self.named_between(damaged.offset, found.unwrap_or(self.end))?;
        Ok(named.or(found))
    }

    /// As [`behind`](Self::behind), without the summary.
    fn found_behind(&mut self, from: u64, damaged: Unreadable) -> McapResult<Option<u64>> {
        let Unreadable {
            offset,
            len_bytes,
            fields_len_bytes,
        } = damaged;
        let place = |len| offset.saturating_add(len);
        let said = len_bytes.map(place);
        let by_fields = fields_len_bytes.map(place);
        if let Some(next) = by_fields.filter(|it| self.is_credible(*it, Behind::Any)) {
            return Ok(Some(next));
        }
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
                if here.starts_with(&DATA_END) && self.has_summary_behind(place)
                    || self.is_chunk(here, place)?
                {
                    return Ok(Some(place));
                }
            }
            start += WINDOW_BYTES as u64;
        }
        Ok(None)
    }

    /// Whether `bytes`, which are at this place, begin with the head of a chunk whose checksum is right.
    fn is_chunk(&mut self, bytes: &[u8], place: u64) -> McapResult<bool> {
        let Some(chunk_len) = chunk_len(bytes, self.end - place) else {
            return Ok(false);
        };
        // Nothing more is found when so much was read.
        self.left = self.left.saturating_sub(chunk_len);
        if self.left == 0 {
            return Ok(false);
        }
        let record = RecordReader::new(self.file, place, self.end).next()?;
        Ok(record.is_some_and(|it| it.verify().is_ok()))
    }

    /// Whether nothing but records of a summary, or a part of one, are behind the end of the data at this place. A
    /// payload can have the bytes of that record.
    fn has_summary_behind(&mut self, place: u64) -> bool {
        let mut reader = RecordReader::new(self.file, place, self.end);
        let mut is_first = true;
        loop {
            let record = match reader.next() {
                Ok(Some(it)) => it,
                Ok(None) => return true,
                Err(_) => return !is_first,
            };
            self.left = self.left.saturating_sub(record.len_bytes());
            if self.left == 0 {
                return true;
            }
            match record.opcode {
                op::DATA_END if is_first => {}
                op::FOOTER => return true,
                op::SCHEMA | op::CHANNEL | op::STATISTICS | op::SUMMARY_OFFSET => {}
                op::CHUNK_INDEX | op::ATTACHMENT_INDEX | op::METADATA_INDEX => {}
                _ => return false,
            }
            is_first = false;
        }
    }
}
