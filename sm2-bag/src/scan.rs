//! Rebuilding the summary of a bag from its records.

use std::collections::{BTreeMap, HashMap};
use std::fs::File;
use std::sync::Arc;

use mcap::records::{ChunkIndex, Metadata, Record, op};
use mcap::{Channel, MAGIC, McapError, McapResult, Schema, Summary};

use crate::chunk::{Entry, RawRecord, RecordReader};
use crate::error::ReadError;
use crate::observer::{Observer, note};
use crate::report::{Counts, widen};

/// Messages that are in no chunk are read together up to this length, in bytes.
const RUN_BYTES: u64 = 1 << 20;

/// The content of a bag, as its records say.
#[derive(Debug, Default)]
pub(crate) struct Scan {
    /// The channels, the schemas and the places of the chunks.
    pub(crate) summary: Summary,
    pub(crate) counts: BTreeMap<u16, Counts>,
    /// The `log_time` of the first and of the last message.
    pub(crate) times: Option<(u64, u64)>,
    /// The places of messages that are in no chunk: each stands for messages that follow each other.
    pub(crate) runs: Vec<ChunkIndex>,
    /// The place of the first chunk whose head names other times than its messages have.
    pub(crate) wrong_times: Option<u64>,
    /// The metadata records, in their order.
    pub(crate) metadata: Vec<Metadata>,
    /// The place and the reason at which reading ended, if it was not the end of the data.
    pub(crate) damage: Option<(u64, McapError)>,
}

impl Scan {
    /// Reads all records of a file that begins with the magic bytes, until the end of the data or the first damage.
    pub(crate) fn of(
        file: &File,
        end: u64,
        observer: &mut Observer<'_>,
    ) -> Result<Self, ReadError> {
        let mut scan = Self::default();
        let mut reader = RecordReader::new(file, MAGIC.len() as u64, end);
        let mut offset = MAGIC.len() as u64;
        loop {
            match reader.next() {
                Ok(Some(record)) if record.opcode == op::DATA_END => return Ok(scan),
                Ok(Some(record)) => match scan.add(&record) {
                    Ok(()) => {
                        offset = record.offset + record.len_bytes();
                        note(observer, record.len_bytes())?;
                    }
                    Err(error) => {
                        scan.damage = Some((record.offset, error));
                        return Ok(scan);
                    }
                },
                Ok(None) => {
                    scan.damage = Some((offset, McapError::UnexpectedEof));
                    return Ok(scan);
                }
                Err(error) => {
                    scan.damage = Some((offset, error));
                    return Ok(scan);
                }
            }
        }
    }

    /// Adds a record, or nothing of it if it is damaged.
    pub(crate) fn add(&mut self, record: &RawRecord) -> McapResult<()> {
        let mut added = Added::default();
        match record.opcode {
            op::CHUNK => {
                record.entries(|entry| self.entry(entry, &mut added))?;
                let mut index = chunk_index(record)?;
                let named = (index.message_start_time, index.message_end_time);
                if let Some(times) = added.times.filter(|it| *it != named) {
                    // Other programs write 0. The messages themselves are right: the checksum covers them.
                    (index.message_start_time, index.message_end_time) = times;
                    self.wrong_times.get_or_insert(record.offset);
                }
                self.summary.chunk_indexes.push(index);
            }
            op::SCHEMA | op::CHANNEL | op::MESSAGE | op::METADATA => {
                record.entries(|entry| self.entry(entry, &mut added))?;
                if let Some(times) = added.times {
                    self.add_to_run(record, times);
                }
            }
            // A zero opcode is not legal: this part of the file was never written.
            0 => return Err(McapError::UnexpectedEof),
            _ => {}
        }
        self.metadata.extend(added.metadata);
        for (channel, counts) in added.counts {
            let sum = self.counts.entry(channel).or_default();
            sum.messages += counts.messages;
            sum.bytes += counts.bytes;
        }
        for time in added.times.into_iter().flat_map(|(from, to)| [from, to]) {
            widen(&mut self.times, time);
        }
        Ok(())
    }

    /// Adds a message that is in no chunk.
    fn add_to_run(&mut self, record: &RawRecord, (from, to): (u64, u64)) {
        let len = record.len_bytes();
        if let Some(last) = self.runs.last_mut()
            && last.chunk_start_offset + last.chunk_length == record.offset
            && last.chunk_length + len <= RUN_BYTES
        {
            last.chunk_length += len;
            last.message_start_time = last.message_start_time.min(from);
            last.message_end_time = last.message_end_time.max(to);
            return;
        }
        self.runs.push(ChunkIndex {
            message_start_time: from,
            message_end_time: to,
            chunk_start_offset: record.offset,
            chunk_length: len,
            message_index_offsets: BTreeMap::new(),
            message_index_length: 0,
            compression: String::new(),
            compressed_size: len,
            uncompressed_size: len,
        });
    }

    fn entry(&mut self, entry: Entry<'_>, added: &mut Added) -> McapResult<()> {
        match entry {
            Entry::Schema(schema) => {
                let schema = Schema {
                    data: schema.data.into_owned().into(),
                    ..schema
                };
                self.summary.schemas.insert(schema.id, Arc::new(schema));
            }
            Entry::Channel(channel) => {
                let schema = match channel.schema_id {
                    0 => None,
                    id => {
                        let schema = self.summary.schemas.get(&id).cloned();
                        let unknown = || McapError::UnknownSchema(channel.topic.clone(), id);
                        Some(schema.ok_or_else(unknown)?)
                    }
                };
                let channel = Channel {
                    id: channel.id,
                    topic: channel.topic,
                    schema,
                    message_encoding: channel.message_encoding,
                    metadata: channel.metadata,
                };
                self.summary.channels.insert(channel.id, Arc::new(channel));
            }
            Entry::Message(header, data) => {
                let id = header.channel_id;
                if !self.summary.channels.contains_key(&id) {
                    return Err(McapError::UnknownChannel(header.sequence, id));
                }
                added.counts.entry(id).or_default().add(data.len());
                widen(&mut added.times, header.log_time);
            }
            Entry::Metadata(metadata) => added.metadata.push(metadata),
        }
        Ok(())
    }
}

/// The content of one record, which counts once the record was read to its end.
#[derive(Default)]
struct Added {
    counts: HashMap<u16, Counts>,
    times: Option<(u64, u64)>,
    metadata: Vec<Metadata>,
}

/// The entry of a chunk in the summary.
fn chunk_index(record: &RawRecord) -> McapResult<ChunkIndex> {
    let Record::Chunk { header, .. } = record.parse()? else {
        return Err(McapError::BadIndex);
    };
    Ok(ChunkIndex {
        message_start_time: header.message_start_time,
        message_end_time: header.message_end_time,
        chunk_start_offset: record.offset,
        chunk_length: record.len_bytes(),
        message_index_offsets: BTreeMap::new(),
        message_index_length: 0,
        compression: header.compression,
        compressed_size: header.compressed_size,
        uncompressed_size: header.uncompressed_size,
    })
}
