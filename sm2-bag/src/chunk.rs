//! The records of an MCAP file, one by one, with every length checked before memory is allocated for it.
//!
//! The readers of the crate `mcap` trust the file. The indexed reader allocates as many bytes as an entry of the
//! summary says. The parser subtracts without a check if a record in an uncompressed chunk is too long, and the reader
//! of the summary panics on a short attachment. This crate therefore frames records itself, checks each length and each
//! checksum first, and uses the summary only to find chunks. Chunks may not overlap, so reading each of them costs no
//! more than the file has. `tests/damage.rs` changes a bit of every byte, and `tests/power_cut.rs` leaves out random
//! sectors of the writes since the last `fdatasync`.

use std::borrow::Cow;
use std::fs::File;
use std::io;
use std::ops::Range;
use std::os::unix::fs::FileExt;

use crc32fast::Hasher;
use mcap::records::{ChunkHeader, MessageHeader, Metadata, Record, op};
use mcap::sans_io::{LinearReadEvent, LinearReader, LinearReaderOptions};
use mcap::{Attachment, McapError, McapResult, Schema};

use crate::attachment;
use crate::checksum;
use crate::lengths;

/// The first opcode that MCAP leaves to programs.
const PRIVATE: u8 = 0x80;

/// The length of the opcode and the length field of a record, in bytes.
pub(crate) const RECORD_HEAD_BYTES: usize = 9;
/// The length of the head of a chunk without compression, in bytes.
pub(crate) const CHUNK_HEAD_BYTES: usize = 8 + 8 + 8 + 4 + 4 + 8;
/// The length of the head of a message, in bytes.
pub(crate) const MESSAGE_HEAD_BYTES: usize = 2 + 4 + 8 + 8;
/// The length of everything in a chunk of one message that stands before the payload, in bytes.
pub(crate) const LONG_HEAD_BYTES: usize =
    RECORD_HEAD_BYTES + CHUNK_HEAD_BYTES + RECORD_HEAD_BYTES + MESSAGE_HEAD_BYTES;

/// The length of the head of a chunk with the longest name of a compression, in bytes.
pub(crate) const CHUNK_SHAPE_BYTES: usize = RECORD_HEAD_BYTES + CHUNK_HEAD_BYTES + 4;

/// How many bytes are read at a time only to compute their checksum.
const PART_BYTES: usize = 64 << 10;

/// The longest content of a compressed chunk that is read, in bytes: the longest message that a subscriber accepts by
/// default, and room for its head. A few bytes can stand for so many.
pub(crate) const CHUNK_MAX_BYTES: usize = (1 << 30) + 4_096;

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

/// Compares the checksum of a chunk with that of its records.
pub(crate) const fn verify_crc(saved: u32, calculated: u32) -> McapResult<()> {
    match checksum::is_right(saved, calculated) {
        true => Ok(()),
        false => Err(McapError::BadChunkCrc { saved, calculated }),
    }
}

/// A record that matters for the messages of a bag.
#[derive(Debug)]
pub(crate) enum Entry<'a> {
    Schema(Schema<'a>),
    Channel(mcap::records::Channel),
    Message(MessageHeader, Cow<'a, [u8]>),
    Metadata(Metadata),
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
        self.entries(|_| Ok(()))
    }

    /// As [`verify`](Self::verify), without the records inside.
    pub(crate) fn verify_kind(&self) -> McapResult<()> {
        match self.opcode {
            // A zero opcode is not legal: this part of the file was never written.
            0 => return Err(McapError::UnexpectedEof),
            op::HEADER | op::MESSAGE_INDEX => {}
            op::SCHEMA | op::CHANNEL | op::MESSAGE | op::CHUNK | op::METADATA => {}
            op::ATTACHMENT => self.attachment().map(drop)?,
            PRIVATE.. => {}
            // The others belong into the summary.
            _ => return Err(McapError::BadIndex),
        }
        match self.is_mislabelled_chunk() {
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
        chunk.entries(|_| Ok(())).is_ok()
    }

    pub(crate) fn parse(&self) -> McapResult<Record<'_>> {
        parse(self.opcode, &self.bytes[RECORD_HEAD_BYTES..])
    }

    /// Passes this record to `each`, or the records inside if it is a chunk, whose checksum is verified first.
    pub(crate) fn entries(
        &self,
        mut each: impl FnMut(Entry<'_>) -> McapResult<()>,
    ) -> McapResult<()> {
        let body = &self.bytes[RECORD_HEAD_BYTES..];
        if self.opcode != op::CHUNK {
            return entry(self.opcode, body)?.map_or(Ok(()), each);
        }
        if !ChunkShape::of(&self.bytes).is_some_and(|it| it.is_consistent()) {
            return Err(McapError::UnexpectedEoc);
        }
        match self.parse()? {
            Record::Chunk { header, data } if header.compression.is_empty() => {
                uncompressed_entries(&header, &data, &mut each)
            }
            Record::Chunk { header, .. } if header.uncompressed_size > CHUNK_MAX_BYTES as u64 => {
                Err(McapError::ChunkTooLarge(header.uncompressed_size))
            }
            _ => self.compressed_entries(&mut each),
        }
    }

    /// Passes the records of a compressed chunk to `each`.
    fn compressed_entries(
        &self,
        each: &mut impl FnMut(Entry<'_>) -> McapResult<()>,
    ) -> McapResult<()> {
        let options = LinearReaderOptions::default()
            .with_skip_start_magic(true)
            .with_skip_end_magic(true)
            .with_prevalidate_chunk_crcs(true)
            .with_record_length_limit(CHUNK_MAX_BYTES.max(self.bytes.len()));
        let mut reader = LinearReader::new_with_options(options);
        let mut left = self.bytes.as_slice();
        while let Some(event) = reader.next_event() {
            match event? {
                LinearReadEvent::ReadRequest(want) => {
                    let (now, later) = left.split_at(want.min(left.len()));
                    reader.insert(now.len()).copy_from_slice(now);
                    // An empty slice tells the reader that the record is over.
                    reader.notify_read(now.len());
                    left = later;
                }
                LinearReadEvent::Record { data, opcode } => {
                    if let Some(entry) = entry(opcode, data)? {
                        each(entry)?;
                    }
                }
            }
        }
        Ok(())
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

/// Passes the records of an uncompressed chunk to `each`. The reader of the crate would read beyond the end of a chunk
/// whose last record has a wrong length.
fn uncompressed_entries(
    header: &ChunkHeader,
    data: &[u8],
    each: &mut impl FnMut(Entry<'_>) -> McapResult<()>,
) -> McapResult<()> {
    verify_crc(header.uncompressed_crc, crc32fast::hash(data))?;
    let mut left = data;
    while let Some((head, rest)) = left.split_first_chunk::<RECORD_HEAD_BYTES>() {
        let [opcode, len @ ..] = *head;
        let len = usize::try_from(u64::from_le_bytes(len));
        let len = len.map_err(|_| McapError::UnexpectedEoc)?;
        let (body, after) = rest.split_at_checked(len).ok_or(McapError::UnexpectedEoc)?;
        if let Some(entry) = entry(opcode, body)? {
            each(entry)?;
        }
        left = after;
    }
    match left.is_empty() {
        true => Ok(()),
        false => Err(McapError::UnexpectedEoc),
    }
}

/// Reads a record whose lengths fit into it.
fn parse(opcode: u8, body: &[u8]) -> McapResult<Record<'_>> {
    lengths::check(opcode, body)?;
    mcap::parse_record(opcode, body)
}

/// Reads a record; `None` if it does not matter here.
fn entry(opcode: u8, data: &[u8]) -> McapResult<Option<Entry<'_>>> {
    // Others, such as attachments, are not parsed: the parser of the crate panics on short ones.
    if !matches!(
        opcode,
        op::SCHEMA | op::CHANNEL | op::MESSAGE | op::METADATA
    ) {
        return Ok(None);
    }
    Ok(match parse(opcode, data)? {
        Record::Schema { header, data } => Some(Entry::Schema(Schema {
            id: header.id,
            name: header.name,
            encoding: header.encoding,
            data,
        })),
        Record::Channel(channel) => Some(Entry::Channel(channel)),
        Record::Message { header, data } => Some(Entry::Message(header, data)),
        Record::Metadata(metadata) => Some(Entry::Metadata(metadata)),
        _ => None,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The parser of the crate `mcap` has another error for it, and allocates 4 GiB before.
    #[test]
    fn a_text_is_not_longer_than_its_record() {
        let long_topic = [&[0; 4][..], &u32::MAX.to_le_bytes(), b"topic"].concat();
        let error = entry(op::CHANNEL, &long_topic).unwrap_err();
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
}
