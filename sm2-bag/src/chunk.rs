//! The records of an MCAP file, one by one, with every length checked before memory is allocated for it.
//!
//! The readers of the crate `mcap` trust the file. The indexed reader allocates as many bytes as an entry of the
//! summary says. The parser subtracts without a check if a record in an uncompressed chunk is too long, and the reader
//! of the summary panics on a short attachment. This crate therefore frames records itself, checks each length and each
//! checksum first, and uses the summary only to find chunks. Chunks may not overlap, so reading each of them costs no
//! more than the file has. `tests/damage.rs` changes a bit of every byte, and `tests/power_cut.rs` leaves out random
//! sectors of the writes since the last `fdatasync`.

use std::fs::File;
use std::io;
use std::ops::Range;
use std::os::unix::fs::FileExt;

use crc32fast::Hasher;
use mcap::records::{Record, op};
use mcap::{Attachment, MAGIC, McapError, McapResult};

use crate::attachment;
use crate::content::{Entry, Visit, WithoutPayloads, visit_chunk, visit_record};
use crate::lengths;
pub(crate) use crate::lengths::{MESSAGE_HEAD_BYTES, RECORD_HEAD_BYTES};

/// The first opcode that MCAP leaves to programs.
pub(crate) const PRIVATE: u8 = 0x80;

/// The length of the head of a chunk without compression, in bytes.
pub(crate) const CHUNK_HEAD_BYTES: usize = 8 + 8 + 8 + 4 + 4 + 8;
/// The length of everything in a chunk of one message that stands before the payload, in bytes.
pub(crate) const LONG_HEAD_BYTES: usize =
    RECORD_HEAD_BYTES + CHUNK_HEAD_BYTES + RECORD_HEAD_BYTES + MESSAGE_HEAD_BYTES;

/// The length of the head of a chunk with the longest name of a compression, in bytes.
pub(crate) const CHUNK_SHAPE_BYTES: usize = RECORD_HEAD_BYTES + CHUNK_HEAD_BYTES + 4;

/// How many bytes are read at a time only to compute their checksum.
const PART_BYTES: usize = 64 << 10;

/// A record of the file.
#[derive(Debug)]
pub(crate) struct RawRecord {
    pub(crate) opcode: u8,
    /// The place of the record in the file, in bytes.
    pub(crate) offset: u64,
    /// The opcode, the length and the body.
    bytes: Vec<u8>,
}

/// Reads the records of a file in their order.
#[derive(Debug)]
pub(crate) struct RecordReader<'a> {
    file: &'a File,
    /// The place of the next record.
    offset: u64,
    /// The length of the file.
    end: u64,
}

impl<'a> RecordReader<'a> {
    /// Reads the records that begin at `offset`.
    pub(crate) const fn new(file: &'a File, offset: u64, end: u64) -> Self {
        Self { file, offset, end }
    }

    /// The next record; `None` at the end of the file.
    pub(crate) fn next(&mut self) -> McapResult<Option<RawRecord>> {
        let left = self.end.saturating_sub(self.offset);
        if left == 0 {
            return Ok(None);
        }
        // The end can be before that of the file.
        let head_bytes = RECORD_HEAD_BYTES as u64;
        let len_max = left.checked_sub(head_bytes);
        let len_max = len_max.ok_or(McapError::UnexpectedEof)?;
        let mut head = [0; RECORD_HEAD_BYTES];
        self.read(&mut head)?;
        let [opcode, len @ ..] = head;
        let len = u64::from_le_bytes(len);
        if len > len_max {
            return Err(McapError::UnexpectedEof);
        }
        let size = usize::try_from(head_bytes + len);
        let mut bytes = vec![0; size.map_err(|_| McapError::UnexpectedEof)?];
        self.read(&mut bytes)?;
        let offset = self.offset;
        self.offset += bytes.len() as u64;
        Ok(Some(RawRecord {
            opcode,
            offset,
            bytes,
        }))
    }

    fn read(&self, bytes: &mut [u8]) -> McapResult<()> {
        of_read(self.file.read_exact_at(bytes, self.offset))
    }
}

/// The result of a read. A file that is shorter than its records say is damaged.
pub(crate) fn of_read(read: io::Result<()>) -> McapResult<()> {
    read.map_err(|error| match error.kind() {
        io::ErrorKind::UnexpectedEof => McapError::UnexpectedEof,
        _ => McapError::Io(error),
    })
}

/// Whether a file of `end` bytes has the last bytes of a bag.
pub(crate) fn ends_in_order(file: &File, end: u64) -> bool {
    let mut magic = [0; MAGIC.len()];
    let at = end.saturating_sub(MAGIC.len() as u64);
    file.read_exact_at(&mut magic, at).is_ok() && magic == MAGIC
}

/// Adds a part of a file to a checksum. It is not kept in memory.
pub(crate) fn hash_part(file: &File, part: Range<u64>, crc: &mut Hasher) -> McapResult<()> {
    let mut bytes = vec![0; PART_BYTES];
    let mut at = part.start;
    while at < part.end {
        let len = (part.end - at).min(PART_BYTES as u64) as usize;
        of_read(file.read_exact_at(&mut bytes[..len], at))?;
        crc.update(&bytes[..len]);
        at += len as u64;
    }
    Ok(())
}

impl RawRecord {
    /// The length of the record in the file, in bytes.
    pub(crate) const fn len_bytes(&self) -> u64 {
        self.bytes.len() as u64
    }

    /// The record as it is in the file.
    pub(crate) fn bytes(&self) -> &[u8] {
        &self.bytes
    }

    /// Whether the data of the file ends here.
    pub(crate) const fn is_data_end(&self) -> bool {
        self.opcode == op::DATA_END && self.bytes.len() == RECORD_HEAD_BYTES + 4
    }

    /// Checks what can be checked of a record in the data of a file without the records before it.
    pub(crate) fn verify(&self) -> McapResult<()> {
        self.verify_kind()?;
        self.visit(&mut WithoutPayloads(|_: Entry<'_>| Ok(())))
    }

    /// As [`verify`](Self::verify), without the records inside.
    pub(crate) fn verify_kind(&self) -> McapResult<()> {
        match self.opcode {
            // A zero opcode is not legal: this part of the file was never written.
            0 => return Err(McapError::UnexpectedEof),
            op::HEADER | op::MESSAGE_INDEX => self.verify_lengths()?,
            op::SCHEMA | op::CHANNEL | op::MESSAGE | op::CHUNK | op::METADATA => {}
            op::ATTACHMENT => self.attachment().map(drop)?,
            PRIVATE.. => {}
            // The others belong into the summary.
            _ => return Err(McapError::BadIndex),
        }
        match self.is_mislabelled_as_private() || self.is_mislabelled_chunk() {
            true => Err(McapError::BadIndex),
            false => Ok(()),
        }
    }

    /// The attachment that this record is. Its checksum is verified.
    pub(crate) fn attachment(&self) -> McapResult<Attachment<'_>> {
        match self.opcode {
            op::ATTACHMENT => attachment::parse(&self.bytes[RECORD_HEAD_BYTES..]),
            _ => Err(McapError::BadIndex),
        }
    }

    /// Whether this record, directly behind a chunk or an index, is an index with the opcode of a message: by its
    /// lengths.
    pub(crate) fn is_mislabelled_index(&self) -> bool {
        let entries = self.bytes[RECORD_HEAD_BYTES..].split_at_checked(6);
        let said = entries.and_then(|(head, _)| head.last_chunk());
        let said = said.map(|it| u32::from_le_bytes(*it) as usize);
        let has = entries.map(|(_, entries)| entries.len());
        self.opcode == op::MESSAGE && said == has && has.is_some_and(|it| it % 16 == 0)
    }

    /// Fails if the lengths of the fields do not fit into this record.
    fn verify_lengths(&self) -> McapResult<()> {
        lengths::check(self.opcode, &self.bytes[RECORD_HEAD_BYTES..]).map(drop)
    }

    /// The bytes behind the fields of a record whose fields say where they end.
    pub(crate) fn behind_fields(&self) -> Option<&[u8]> {
        lengths::behind_fields(self.opcode, &self.bytes[RECORD_HEAD_BYTES..])
    }

    /// Whether a checksum, or a second length, shows that the length of this record is wrong.
    pub(crate) const fn has_checked_length(&self) -> bool {
        matches!(self.opcode, op::CHUNK | op::ATTACHMENT | op::DATA_END)
    }

    /// Whether this is a record of MCAP with an opcode that MCAP leaves to programs: by its lengths.
    fn is_mislabelled_as_private(&self) -> bool {
        let (opcode, body) = (self.opcode & !PRIVATE, &self.bytes[RECORD_HEAD_BYTES..]);
        let is_exact = || lengths::behind_fields(opcode, body).is_some_and(<[u8]>::is_empty);
        self.opcode >= PRIVATE
            && match opcode {
                op::CHUNK => ChunkShape::of(&self.bytes).is_some_and(|it| it.is_consistent()),
                op::SCHEMA | op::CHANNEL | op::METADATA => is_exact(),
                op::ATTACHMENT => attachment::parse(body).is_ok(),
                _ => false,
            }
    }

    /// Whether this is a chunk with a wrong opcode: by its lengths and its checksum.
    fn is_mislabelled_chunk(&self) -> bool {
        let len = ChunkShape::of(&self.bytes).and_then(|it| it.record_len());
        if self.opcode == op::CHUNK || len != Some(self.len_bytes()) {
            return false;
        }
        let mut bytes = self.bytes.clone();
        bytes[0] = op::CHUNK;
        let (opcode, offset) = (op::CHUNK, self.offset);
        let chunk = Self {
            opcode,
            offset,
            bytes,
        };
        chunk
            .visit(&mut WithoutPayloads(|_: Entry<'_>| Ok(())))
            .is_ok()
    }

    pub(crate) fn parse(&self) -> McapResult<Record<'_>> {
        lengths::parse(self.opcode, &self.bytes[RECORD_HEAD_BYTES..])
    }

    /// Passes this record to `visit`, or the records inside if it is a chunk, whose checksum is verified first.
    pub(crate) fn visit(&self, visit: &mut dyn Visit) -> McapResult<()> {
        if self.opcode != op::CHUNK {
            return visit_record(self.opcode, &self.bytes[RECORD_HEAD_BYTES..], visit);
        }
        if !ChunkShape::of(&self.bytes).is_some_and(|it| it.is_consistent()) {
            return Err(McapError::UnexpectedEoc);
        }
        match self.parse()? {
            Record::Chunk { header, data } => visit_chunk(&header, &data, visit),
            _ => Err(McapError::BadIndex),
        }
    }
}

/// The lengths and the checksum in the head of a chunk.
struct ChunkShape<'a> {
    /// The length of the record without opcode and length, in bytes.
    body_bytes: u64,
    content_bytes: u64,
    crc: u32,
    compression: &'a [u8],
    /// The length of the content as it is in the file.
    stored_bytes: u64,
}

impl<'a> ChunkShape<'a> {
    /// Of `bytes` that begin with a record, whatever its opcode is.
    fn of(bytes: &'a [u8]) -> Option<Self> {
        let (_opcode, rest) = bytes.split_first()?;
        let (body_bytes, rest) = rest.split_first_chunk()?;
        let (_times, rest) = rest.split_first_chunk::<16>()?;
        let (content_bytes, rest) = rest.split_first_chunk()?;
        let (crc, rest) = rest.split_first_chunk()?;
        let (name_bytes, rest) = rest.split_first_chunk()?;
        let name_bytes = usize::try_from(u32::from_le_bytes(*name_bytes)).ok()?;
        let (compression, rest) = rest.split_at_checked(name_bytes)?;
        let (stored_bytes, _) = rest.split_first_chunk()?;
        Some(Self {
            body_bytes: u64::from_le_bytes(*body_bytes),
            content_bytes: u64::from_le_bytes(*content_bytes),
            crc: u32::from_le_bytes(*crc),
            compression,
            stored_bytes: u64::from_le_bytes(*stored_bytes),
        })
    }

    /// Whether the lengths fit together.
    fn is_consistent(&self) -> bool {
        let head = (CHUNK_HEAD_BYTES + self.compression.len()) as u64;
        let is_stored = !self.compression.is_empty() || self.content_bytes == self.stored_bytes;
        is_stored && head.checked_add(self.stored_bytes) == Some(self.body_bytes)
    }

    /// The length of the record, in bytes. `None` without a checksum, with a compression that MCAP does not define, and
    /// if the lengths do not fit together.
    fn record_len(&self) -> Option<u64> {
        let is_known = matches!(self.compression, b"" | b"lz4" | b"zstd");
        let is_chunk = self.crc != 0 && is_known && self.is_consistent();
        self.body_bytes
            .checked_add(RECORD_HEAD_BYTES as u64)
            .filter(|_| is_chunk)
    }
}

/// The length of the record, in bytes, if `bytes` begin with the head of a chunk that has a checksum, whose lengths fit
/// together, and that is not longer than `left`.
pub(crate) fn chunk_len(bytes: &[u8], left: u64) -> Option<u64> {
    if bytes.first() != Some(&op::CHUNK) {
        return None;
    }
    ChunkShape::of(bytes)?.record_len().filter(|it| *it <= left)
}

/// The length of a chunk by the length of its content, in bytes, if `bytes` begin with the head of a chunk. It is that
/// of the record unless the head is damaged.
pub(crate) fn chunk_len_by_content(bytes: &[u8]) -> Option<u64> {
    if bytes.first() != Some(&op::CHUNK) {
        return None;
    }
    let shape = ChunkShape::of(bytes)?;
    let head = RECORD_HEAD_BYTES + CHUNK_HEAD_BYTES + shape.compression.len();
    shape.stored_bytes.checked_add(head as u64)
}

/// Whether the last `left` bytes of a file, which cannot be read, are what a recorder leaves that is killed: a part of
/// a record, or nothing but room. Otherwise they begin with a record that has changed. They begin with `head`, which
/// has [`CHUNK_SHAPE_BYTES`] if there are so many.
pub(crate) fn is_unfinished(head: &[u8], left: u64) -> bool {
    let Some(&[opcode, ref len @ ..]) = head.first_chunk::<RECORD_HEAD_BYTES>() else {
        return true;
    };
    let is_cut = u64::from_le_bytes(*len) > left - RECORD_HEAD_BYTES as u64;
    let is_of_data = matches!(opcode, op::HEADER | op::SCHEMA..=op::MESSAGE_INDEX)
        || matches!(
            opcode,
            op::ATTACHMENT | op::METADATA | op::DATA_END | PRIVATE
        );
    let fits = || opcode != op::CHUNK || ChunkShape::of(head).is_none_or(|it| it.is_consistent());
    opcode == 0 || is_cut && is_of_data && fits()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The parser of the crate `mcap` has another error for it, and allocates 4 GiB before.
    #[test]
    fn a_text_is_not_longer_than_its_record() {
        let long_topic = [&[0; 4][..], &u32::MAX.to_le_bytes(), b"topic"].concat();
        let error = visit_record(op::CHANNEL, &long_topic, &mut |_: Entry<'_>| Ok(()));
        let error = error.unwrap_err();
        assert!(matches!(error, McapError::UnexpectedEoc), "{error}");
        let long_compression = [&[0; RECORD_HEAD_BYTES + 28][..], &[0xff; 4]].concat();
        let record = RawRecord {
            opcode: op::CHUNK,
            offset: 0,
            bytes: long_compression,
        };
        let error = record.parse().unwrap_err();
        assert!(matches!(error, McapError::UnexpectedEoc), "{error}");
    }

    #[test]
    fn an_index_with_another_opcode_is_known_by_its_lengths() {
        // A channel, the length of the entries in bytes, and entries.
        let record = |opcode, said: u32, has: usize| {
            let bytes = [
                &[0; RECORD_HEAD_BYTES + 2][..],
                &said.to_le_bytes(),
                &vec![0; has],
            ];
            RawRecord {
                opcode,
                offset: 0,
                bytes: bytes.concat(),
            }
        };
        for entries in [0, 16, 48] {
            let index = |opcode| record(opcode, entries, entries as usize);
            assert!(index(op::MESSAGE).is_mislabelled_index(), "{entries}");
            assert!(
                !index(op::MESSAGE_INDEX).is_mislabelled_index(),
                "{entries}"
            );
        }
        // A message has its sequence number there, and an entry has 16 bytes.
        for (said, has) in [(1, 16), (16, 32), (15, 15), (17, 17)] {
            let message = record(op::MESSAGE, said, has);
            assert!(!message.is_mislabelled_index(), "{said} {has}");
        }
        let mut short = record(op::MESSAGE, 0, 0);
        short.bytes.pop();
        assert!(!short.is_mislabelled_index());
    }
}
