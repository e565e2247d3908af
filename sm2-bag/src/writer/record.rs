//! The records that this crate writes itself: chunks of one long message, and the summary.
//!
//! A message above 64 KiB is a chunk of its own. A padding record before the chunk puts the payload at the start of a
//! block of the file, so that the blocks bypass the page cache (`O_DIRECT`). The blocks are written before the head of
//! their chunk, which has the checksum. The crate `mcap` makes the chunks of short messages in memory and does not know
//! the long ones, so this crate writes the summary, with the record types of `mcap`. The file is only appended to,
//! through the trait `Storage`: tests put broken disks in its place.

use std::collections::BTreeMap;
use std::io::Cursor;

use binrw::BinWrite;
use mcap::records::{
    Channel, ChunkHeader, ChunkIndex, DataEnd, Footer, MessageHeader, MessageIndex,
    MessageIndexEntry, SchemaHeader, SummaryOffset, op,
};
use mcap::{MAGIC, Summary};

use crate::chunk::{CHUNK_HEAD_BYTES, LONG_HEAD_BYTES, MESSAGE_HEAD_BYTES, RECORD_HEAD_BYTES};
use crate::storage::BLOCK_BYTES;

/// The opcode of a record without meaning, from the range that MCAP leaves to programs.
const PADDING: u8 = 0x80;

/// A chunk of one long message.
pub(super) struct LongChunk {
    /// The records before the payload.
    pub(super) head: Vec<u8>,
    /// The record behind the payload.
    pub(super) tail: Vec<u8>,
    pub(super) index: ChunkIndex,
}

impl LongChunk {
    /// The length of the records before the payload, in bytes, if their first one, a padding, begins at `offset`. The
    /// payload begins with a block of the file.
    pub(super) const fn head_len(offset: u64) -> usize {
        let padding_at = offset as usize;
        let before = padding_at + RECORD_HEAD_BYTES + LONG_HEAD_BYTES;
        before.next_multiple_of(BLOCK_BYTES) - padding_at
    }

    /// Describes the chunk whose padding begins at `offset`. Its payload has this length in bytes and this CRC-32.
    pub(super) fn new(offset: u64, header: &MessageHeader, len: usize, crc: u32) -> Self {
        let head_len = Self::head_len(offset);
        let mut head = Vec::with_capacity(head_len);
        let padding = head_len - RECORD_HEAD_BYTES - LONG_HEAD_BYTES;
        put_head(&mut head, PADDING, padding);
        head.resize(head.len() + padding, 0);

        let start = offset + head.len() as u64;
        let mut message = Vec::with_capacity(RECORD_HEAD_BYTES + MESSAGE_HEAD_BYTES);
        put_head(&mut message, op::MESSAGE, MESSAGE_HEAD_BYTES + len);
        message.extend(body(header));
        let mut whole = crc32fast::Hasher::new();
        whole.update(&message);
        whole.combine(&crc32fast::Hasher::new_with_initial_len(crc, len as u64));
        let size = message.len() + len;
        put_head(&mut head, op::CHUNK, CHUNK_HEAD_BYTES + size);
        head.extend(body(&ChunkHeader {
            message_start_time: header.log_time,
            message_end_time: header.log_time,
            uncompressed_size: size as u64,
            uncompressed_crc: whole.finalize(),
            compression: String::new(),
            compressed_size: size as u64,
        }));
        head.append(&mut message);

        let mut tail = Vec::new();
        let entry = MessageIndexEntry {
            log_time: header.log_time,
            offset: 0,
        };
        put(
            &mut tail,
            op::MESSAGE_INDEX,
            &MessageIndex {
                channel_id: header.channel_id,
                records: vec![entry],
            },
        );
        let chunk_length = (RECORD_HEAD_BYTES + CHUNK_HEAD_BYTES + size) as u64;
        let index = ChunkIndex {
            message_start_time: header.log_time,
            message_end_time: header.log_time,
            chunk_start_offset: start,
            chunk_length,
            message_index_offsets: BTreeMap::from([(header.channel_id, start + chunk_length)]),
            message_index_length: tail.len() as u64,
            compression: String::new(),
            compressed_size: size as u64,
            uncompressed_size: size as u64,
        };
        Self { head, tail, index }
    }
}

/// The end of a bag whose last chunk ends at `offset`: the end of the data, the summary and the footer.
pub(super) fn end(offset: u64, summary: &Summary) -> Vec<u8> {
    let mut out = Vec::new();
    let data_section_crc = 0;
    put(&mut out, op::DATA_END, &DataEnd { data_section_crc });
    let summary_at = out.len();
    let mut groups: Vec<(u8, usize)> = Vec::new();
    let mut group = |out: &Vec<u8>, opcode| groups.push((opcode, out.len()));

    group(&out, op::SCHEMA);
    for schema in sorted(&summary.schemas) {
        let header = SchemaHeader {
            id: schema.id,
            name: schema.name.clone(),
            encoding: schema.encoding.clone(),
        };
        let mut record = body(&header);
        record.extend((schema.data.len() as u32).to_le_bytes());
        record.extend_from_slice(&schema.data);
        put_head(&mut out, op::SCHEMA, record.len());
        out.extend(record);
    }
    group(&out, op::CHANNEL);
    for channel in sorted(&summary.channels) {
        let channel = Channel {
            id: channel.id,
            schema_id: channel.schema.as_ref().map_or(0, |it| it.id),
            topic: channel.topic.clone(),
            message_encoding: channel.message_encoding.clone(),
            metadata: channel.metadata.clone(),
        };
        put(&mut out, op::CHANNEL, &channel);
    }
    group(&out, op::STATISTICS);
    if let Some(stats) = &summary.stats {
        put(&mut out, op::STATISTICS, stats);
    }
    group(&out, op::CHUNK_INDEX);
    for index in &summary.chunk_indexes {
        put(&mut out, op::CHUNK_INDEX, index);
    }
    group(&out, op::METADATA_INDEX);
    for index in &summary.metadata_indexes {
        put(&mut out, op::METADATA_INDEX, index);
    }

    let offsets_at = out.len();
    let ends = groups.iter().skip(1).map(|it| it.1).chain([offsets_at]);
    for ((opcode, from), to) in groups.iter().zip(ends) {
        if *from < to {
            let offset = SummaryOffset {
                group_opcode: *opcode,
                group_start: offset + *from as u64,
                group_length: (to - from) as u64,
            };
            put(&mut out, op::SUMMARY_OFFSET, &offset);
        }
    }
    let footer = Footer {
        summary_start: offset + summary_at as u64,
        summary_offset_start: offset + offsets_at as u64,
        summary_crc: 0,
    };
    put(&mut out, op::FOOTER, &footer);
    // The checksum is over the summary and the footer up to the checksum.
    let crc_at = out.len() - size_of::<u32>();
    let crc = crc32fast::hash(&out[summary_at..crc_at]);
    out[crc_at..].copy_from_slice(&crc.to_le_bytes());
    out.extend_from_slice(MAGIC);
    out
}

/// The values of a map in the order of their keys.
fn sorted<V>(values: &std::collections::HashMap<u16, V>) -> impl Iterator<Item = &V> {
    BTreeMap::from_iter(values).into_values()
}

/// Appends a record.
fn put(out: &mut Vec<u8>, opcode: u8, record: &impl for<'a> BinWrite<Args<'a> = ()>) {
    let body = body(record);
    put_head(out, opcode, body.len());
    out.extend(body);
}

/// Appends the opcode and the length of a record.
fn put_head(out: &mut Vec<u8>, opcode: u8, len: usize) {
    out.push(opcode);
    out.extend((len as u64).to_le_bytes());
}

/// The fields of a record.
fn body(record: &impl for<'a> BinWrite<Args<'a> = ()>) -> Vec<u8> {
    let mut out = Cursor::new(Vec::new());
    record.write_le(&mut out).expect("memory takes all bytes");
    out.into_inner()
}
