//! The payload of a message, in memory or still in the file.

use std::fs::File;
use std::io::{Cursor, Read};
use std::os::unix::fs::FileExt;
use std::path::Path;

use binrw::BinRead;
use crc32fast::Hasher;
use mcap::records::{ChunkHeader, MessageHeader, op};
use mcap::{McapError, McapResult};

use crate::checksum::verify_crc;
use crate::chunk::{
    CHUNK_HEAD_BYTES, LONG_HEAD_BYTES, MESSAGE_HEAD_BYTES, RECORD_HEAD_BYTES, hash_part, of_read,
};
use crate::content::CHUNK_MAX_BYTES;
use crate::error::ReadError;
use crate::writer::COPY_MAX_BYTES;

/// The payload of a message.
#[derive(Debug)]
pub(crate) enum Payload<'a> {
    /// It was read, and its checksum was verified.
    Read(Vec<u8>),
    /// It is a chunk of its own.
    Long(LongPayload<'a>),
    /// It is in memory, and compressed.
    Packed(PackedPayload<'a>),
}

impl Payload<'_> {
    /// The payload in memory.
    pub(crate) fn into_vec(self) -> Result<Vec<u8>, ReadError> {
        match self {
            Self::Read(data) => Ok(data),
            Self::Long(payload) => payload.read_to_vec(),
            Self::Packed(payload) => payload.unpack(),
        }
    }

    /// The memory of the payload, in bytes.
    pub(crate) const fn memory_bytes(&self) -> usize {
        match self {
            Self::Read(data) => data.len(),
            Self::Long(_) => 0,
            Self::Packed(payload) => payload.data.len(),
        }
    }
}

/// A payload that is compressed by zstd on its own, as rosbag2 does it.
#[derive(Debug)]
pub(crate) struct PackedPayload<'a> {
    data: Vec<u8>,
    path: &'a Path,
    /// The place and the length of the chunk, in bytes.
    chunk: (u64, u64),
}

impl<'a> PackedPayload<'a> {
    pub(crate) const fn new(data: Vec<u8>, path: &'a Path, chunk: (u64, u64)) -> Self {
        Self { data, path, chunk }
    }

    /// The payload as it was published.
    fn unpack(self) -> Result<Vec<u8>, ReadError> {
        let mut data = Vec::new();
        let unpack = |data: &mut Vec<u8>| {
            let decoder = zstd::Decoder::with_buffer(self.data.as_slice())?;
            decoder.take(CHUNK_MAX_BYTES + 1).read_to_end(data)?;
            match data.len() as u64 {
                CHUNK_MAX_BYTES.. => Err(McapError::ChunkTooLarge(data.len() as u64)),
                _ => Ok(()),
            }
        };
        let unpacked = unpack(&mut data);
        unpacked.map_err(|error| ReadError::damaged(self.path, self.chunk, error))?;
        Ok(data)
    }
}

/// A payload above 64 KiB that is alone in an uncompressed chunk. It stays in the file until it is read to its place.
#[derive(Debug)]
pub(crate) struct LongPayload<'a> {
    file: &'a File,
    path: &'a Path,
    offset: u64,
    len: usize,
    /// The checksum of the chunk; 0 if the writer has computed none.
    saved_crc: u32,
    /// The checksum of the bytes before the payload.
    crc: Hasher,
}

impl<'a> LongPayload<'a> {
    /// Reads the head of the chunk at `offset` in a file of `end` bytes. `None` if the chunk is of another kind or
    /// damaged, so that the whole of it has to be read.
    pub(crate) fn of_chunk(
        file: &'a File,
        path: &'a Path,
        offset: u64,
        end: u64,
    ) -> McapResult<Option<(MessageHeader, Self)>> {
        let left = end.saturating_sub(offset);
        let mut head = [0; LONG_HEAD_BYTES];
        if left < (LONG_HEAD_BYTES + COPY_MAX_BYTES) as u64 {
            return Ok(None);
        }
        of_read(file.read_exact_at(&mut head, offset))?;
        let Some((header, len, saved_crc)) = parse(&head) else {
            return Ok(None);
        };
        if len <= COPY_MAX_BYTES || len as u64 > left - LONG_HEAD_BYTES as u64 {
            return Ok(None);
        }
        let mut crc = Hasher::new();
        crc.update(&head[RECORD_HEAD_BYTES + CHUNK_HEAD_BYTES..]);
        let payload = Self {
            file,
            path,
            offset: offset + LONG_HEAD_BYTES as u64,
            len,
            saved_crc,
            crc,
        };
        Ok(Some((header, payload)))
    }

    /// Its length, in bytes.
    pub(crate) const fn len(&self) -> usize {
        self.len
    }

    /// Reads the payload to its place, which has its [length](Self::len), and verifies the checksum. After an error,
    /// the bytes in this place are worthless.
    pub(crate) fn read_into(mut self, place: &mut [u8]) -> Result<(), ReadError> {
        let chunk = self.chunk();
        let read = of_read(self.file.read_exact_at(place, self.offset));
        self.crc.update(place);
        let verified = read.and_then(|()| verify_crc(self.saved_crc, self.crc.finalize()));
        verified.map_err(|error| ReadError::damaged(self.path, chunk, error))
    }

    fn read_to_vec(self) -> Result<Vec<u8>, ReadError> {
        let mut data = vec![0; self.len];
        self.read_into(&mut data)?;
        Ok(data)
    }

    /// Verifies the checksum of a payload that is not needed.
    pub(crate) fn verify(mut self) -> McapResult<()> {
        let part = self.offset..self.offset + self.len as u64;
        hash_part(self.file, part, &mut self.crc)?;
        verify_crc(self.saved_crc, self.crc.finalize())
    }

    /// The place and the length of the chunk, in bytes.
    const fn chunk(&self) -> (u64, u64) {
        let head = LONG_HEAD_BYTES as u64;
        (self.offset - head, self.len as u64 + head)
    }
}

/// Parses the bytes before the payload. Returns the head of the message, the length of the payload and the checksum of
/// the chunk. `None` unless the chunk is uncompressed and has this message alone, with the times of the chunk.
fn parse(head: &[u8; LONG_HEAD_BYTES]) -> Option<(MessageHeader, usize, u32)> {
    let (record, rest) = head.split_first_chunk::<RECORD_HEAD_BYTES>()?;
    let (chunk, rest) = rest.split_at(CHUNK_HEAD_BYTES);
    let (message, rest) = rest.split_first_chunk::<RECORD_HEAD_BYTES>()?;
    let length = |head: &[u8; RECORD_HEAD_BYTES], opcode: u8| {
        let [found, len @ ..] = *head;
        (found == opcode).then_some(u64::from_le_bytes(len))
    };
    let chunk_len = length(record, op::CHUNK)?;
    let message_len = length(message, op::MESSAGE)?;
    // A name of a compression is longer than the part for a chunk without one.
    let chunk = ChunkHeader::read_le(&mut Cursor::new(chunk)).ok()?;
    let header = MessageHeader::read_le(&mut Cursor::new(rest)).ok()?;
    let size = message_len.checked_add(RECORD_HEAD_BYTES as u64)?;
    let times = (chunk.message_start_time, chunk.message_end_time);
    let is_alone = chunk.compression.is_empty()
        && (chunk.compressed_size, chunk.uncompressed_size) == (size, size)
        && size.checked_add(CHUNK_HEAD_BYTES as u64) == Some(chunk_len)
        && times == (header.log_time, header.log_time);
    let len = message_len.checked_sub(MESSAGE_HEAD_BYTES as u64)?;
    let len = usize::try_from(len).ok()?;
    is_alone.then_some((header, len, chunk.uncompressed_crc))
}
