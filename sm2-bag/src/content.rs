//! The records inside a chunk.
//!
//! A few compressed bytes can stand for 1 GiB. A short content is decompressed to memory. A longer one is decompressed
//! twice: once for its checksum, and once for its records; only wanted messages come to memory. So a chunk
//! costs as much memory as the messages that the caller keeps, and that of the decompressor: 128 MiB for the largest
//! window that zstd accepts by default, and a few MiB for the windows that programs use.

use std::borrow::Cow;
use std::io::{Cursor, Read};

use binrw::BinRead;
use crc32fast::Hasher;
use mcap::records::{ChunkHeader, MessageHeader, Metadata, Record, op};
use mcap::{McapError, McapResult, Schema};

use crate::checksum::verify_crc;
use crate::lengths::{MESSAGE_HEAD_BYTES, RECORD_HEAD_BYTES, parse};

/// The longest content of a compressed chunk that is read, in bytes: the longest message that a subscriber accepts by
/// default, and room for its head. A few bytes can stand for so many.
pub(crate) const CHUNK_MAX_BYTES: u64 = (1 << 30) + 4_096;
/// The longest content that is decompressed to memory as a whole, and the longest record other than a message in longer
/// contents, in bytes.
const WHOLE_MAX_BYTES: u64 = 8 << 20;
/// How many bytes are decompressed at a time only to compute their checksum, or to skip them.
const PART_BYTES: usize = 64 << 10;

/// A record that matters for the messages of a bag.
#[derive(Debug)]
pub(crate) enum Entry<'a> {
    Schema(Schema<'a>),
    Channel(mcap::records::Channel),
    /// A message, the length of its payload, and the payload if it is [wanted](Visit::wants).
    Message(MessageHeader, usize, Option<Cow<'a, [u8]>>),
    Metadata(Metadata),
}

/// Gets the records of a chunk.
pub(crate) trait Visit {
    /// Whether the payload of a message is needed. Called once for each message, in the order of the file.
    fn wants(&mut self, header: &MessageHeader, len: usize) -> bool;

    fn entry(&mut self, entry: Entry<'_>) -> McapResult<()>;
}

/// Passes records to a function, with all payloads.
impl<F: FnMut(Entry<'_>) -> McapResult<()>> Visit for F {
    fn wants(&mut self, _: &MessageHeader, _: usize) -> bool {
        true
    }

    fn entry(&mut self, entry: Entry<'_>) -> McapResult<()> {
        self(entry)
    }
}

/// Passes records to a function, without payloads.
pub(crate) struct WithoutPayloads<F>(pub(crate) F);

impl<F: FnMut(Entry<'_>) -> McapResult<()>> Visit for WithoutPayloads<F> {
    fn wants(&mut self, _: &MessageHeader, _: usize) -> bool {
        false
    }

    fn entry(&mut self, entry: Entry<'_>) -> McapResult<()> {
        (self.0)(entry)
    }
}

/// Passes a record that is in no chunk to `visit`.
pub(crate) fn visit_record(opcode: u8, body: &[u8], visit: &mut dyn Visit) -> McapResult<()> {
    // Others, such as attachments, are not parsed: the parser of the crate panics on short ones.
    if !matters(opcode) {
        return Ok(());
    }
    let entry = match parse(opcode, body)? {
        Record::Schema { header, data } => Entry::Schema(Schema {
            id: header.id,
            name: header.name,
            encoding: header.encoding,
            data,
        }),
        Record::Channel(channel) => Entry::Channel(channel),
        Record::Message { header, data } => {
            let is_wanted = visit.wants(&header, data.len());
            let len = data.len();
            Entry::Message(header, len, Some(data).filter(|_| is_wanted))
        }
        Record::Metadata(metadata) => Entry::Metadata(metadata),
        _ => return Ok(()),
    };
    visit.entry(entry)
}

/// Passes the records of a chunk to `visit`, whose checksum is verified first.
pub(crate) fn visit_chunk(
    header: &ChunkHeader,
    stored: &[u8],
    visit: &mut dyn Visit,
) -> McapResult<()> {
    let len = header.uncompressed_size;
    if header.compression.is_empty() {
        return visit_whole(header, stored, visit);
    }
    if len > CHUNK_MAX_BYTES {
        return Err(McapError::ChunkTooLarge(len));
    }
    if len > WHOLE_MAX_BYTES {
        verify_content(header, stored)?;
        return visit_content(decompressor(header, stored)?, len, visit);
    }
    let mut content = Vec::new();
    // One byte more, so that a longer content is not taken for this one.
    let mut start = decompressor(header, stored)?.take(len + 1);
    start.read_to_end(&mut content)?;
    match content.len() as u64 == len {
        true => visit_whole(header, &content, visit),
        false => Err(McapError::UnexpectedEoc),
    }
}

/// Decompresses the content of a chunk.
fn decompressor<'a>(header: &ChunkHeader, stored: &'a [u8]) -> McapResult<Box<dyn Read + 'a>> {
    Ok(match header.compression.as_str() {
        "zstd" => Box::new(zstd::Decoder::with_buffer(stored)?),
        "lz4" => Box::new(lz4::Decoder::new(stored)?),
        other => return Err(McapError::UnsupportedCompression(other.to_owned())),
    })
}

/// Passes the records of a content in memory to `visit`. The reader of the crate would read beyond the end of a chunk
/// whose last record has a wrong length.
fn visit_whole(header: &ChunkHeader, content: &[u8], visit: &mut dyn Visit) -> McapResult<()> {
    verify_crc(header.uncompressed_crc, crc32fast::hash(content))?;
    let mut left = content;
    while let Some((head, rest)) = left.split_first_chunk::<RECORD_HEAD_BYTES>() {
        let [opcode, len @ ..] = *head;
        let len = usize::try_from(u64::from_le_bytes(len));
        let len = len.map_err(|_| McapError::UnexpectedEoc)?;
        let (body, after) = rest.split_at_checked(len).ok_or(McapError::UnexpectedEoc)?;
        visit_record(opcode, body, visit)?;
        left = after;
    }
    match left.is_empty() {
        true => Ok(()),
        false => Err(McapError::UnexpectedEoc),
    }
}

/// Verifies length and checksum of a compressed content.
fn verify_content(header: &ChunkHeader, stored: &[u8]) -> McapResult<()> {
    let mut content = decompressor(header, stored)?;
    let mut crc = Hasher::new();
    let mut left = header.uncompressed_size;
    let mut part = vec![0; PART_BYTES];
    loop {
        let len = content.read(&mut part)?;
        left = match left.checked_sub(len as u64) {
            Some(left) => left,
            None => return Err(McapError::UnexpectedEoc),
        };
        if len == 0 {
            break;
        }
        crc.update(&part[..len]);
    }
    match left {
        0 => verify_crc(header.uncompressed_crc, crc.finalize()),
        _ => Err(McapError::UnexpectedEoc),
    }
}

/// Passes the records of a content of `len` bytes to `visit`.
fn visit_content(
    mut content: Box<dyn Read + '_>,
    len: u64,
    visit: &mut dyn Visit,
) -> McapResult<()> {
    let mut left = len;
    let mut take = |bytes: u64| match left.checked_sub(bytes) {
        Some(rest) => {
            left = rest;
            Ok(rest)
        }
        None => Err(McapError::UnexpectedEoc),
    };
    while take(0)? > 0 {
        take(RECORD_HEAD_BYTES as u64)?;
        let mut head = [0; RECORD_HEAD_BYTES];
        content.read_exact(&mut head)?;
        let [opcode, len @ ..] = head;
        let body_bytes = u64::from_le_bytes(len);
        take(body_bytes)?;
        if opcode == op::MESSAGE {
            visit_message(&mut content, body_bytes, visit)?;
        } else if !matters(opcode) {
            skip(&mut content, body_bytes)?;
        } else if body_bytes > WHOLE_MAX_BYTES {
            return Err(McapError::RecordTooLarge {
                opcode,
                len: body_bytes,
            });
        } else {
            let mut body = vec![0; body_bytes as usize];
            content.read_exact(&mut body)?;
            visit_record(opcode, &body, visit)?;
        }
    }
    Ok(())
}

/// Passes a message to `visit`. Its payload comes to memory only if it is wanted.
fn visit_message(content: &mut dyn Read, body_bytes: u64, visit: &mut dyn Visit) -> McapResult<()> {
    let len = body_bytes.checked_sub(MESSAGE_HEAD_BYTES as u64);
    let len = len.and_then(|it| usize::try_from(it).ok());
    let len = len.ok_or(McapError::UnexpectedEoc)?;
    let mut head = [0; MESSAGE_HEAD_BYTES];
    content.read_exact(&mut head)?;
    let header = MessageHeader::read_le(&mut Cursor::new(head))?;
    let data = match visit.wants(&header, len) {
        true => {
            let mut data = vec![0; len];
            content.read_exact(&mut data)?;
            Some(data.into())
        }
        false => {
            skip(content, len as u64)?;
            None
        }
    };
    visit.entry(Entry::Message(header, len, data))
}

fn skip(content: &mut dyn Read, mut len: u64) -> McapResult<()> {
    let mut part = vec![0; PART_BYTES.min(len as usize)];
    while len > 0 {
        let now = len.min(part.len() as u64) as usize;
        content.read_exact(&mut part[..now])?;
        len -= now as u64;
    }
    Ok(())
}

/// Whether records of this kind are parsed here.
const fn matters(opcode: u8) -> bool {
    matches!(
        opcode,
        op::SCHEMA | op::CHANNEL | op::MESSAGE | op::METADATA
    )
}
