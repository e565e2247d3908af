//! Rebuilding the summary of a bag from its records.

use std::collections::{BTreeMap, HashMap};
use std::fs::File;
use std::ops::Range;
use std::os::unix::fs::FileExt;
use std::path::Path;
use std::sync::Arc;

use mcap::records::{ChunkIndex, Metadata, Record, op};
use mcap::{Channel, MAGIC, McapError, McapResult, Schema, Summary};

use crate::checksum;
use crate::chunk::{self, CHUNK_SHAPE_BYTES, RECORD_HEAD_BYTES, RawRecord, RecordReader, of_read};
use crate::content::{Entry, WithoutPayloads};
use crate::damaged::DamagedPart;
use crate::error::{ReadError, is_of_system};
use crate::landmarks::Landmarks;
use crate::observer::{Observer, report_progress};
use crate::report::{Counts, widen};
use crate::resync::{Resync, Unreadable};

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
    /// The places and lengths of the attachments.
    pub(crate) attachments: Vec<(u64, u64)>,
    /// The damaged parts that have something behind them.
    pub(crate) damaged: Vec<DamagedPart>,
    /// The unreadable end of a file whose data do not end in order. It may be empty.
    pub(crate) torn: Option<DamagedPart>,
    /// Whether a recorder that is killed leaves such an end.
    pub(crate) is_unfinished: bool,
    /// The fault, if the checksum over all records is wrong, and none of them shows damage.
    pub(crate) wrong_crc: Option<McapError>,
}

impl Scan {
    /// Reads all records of a file that begins with the magic bytes, but for damaged parts. A channel may be described
    /// in a damaged part alone, so `known` is the summary of the file, if it can be read.
    ///
    /// # Errors
    ///
    /// [`ReadError::Io`], [`ReadError::Stopped`].
    pub(crate) fn of(
        path: &Path,
        file: &File,
        end: u64,
        known: Option<Summary>,
        observer: &mut Observer<'_>,
    ) -> Result<Self, ReadError> {
        let failed = |error| ReadError::io(path, error);
        let mut scan = Self::default();
        let known = known.unwrap_or_default();
        let mut resync = Resync::new(file, end, Landmarks::of(&known));
        (scan.summary.schemas, scan.summary.channels) = (known.schemas, known.channels);
        if end < MAGIC.len() as u64 {
            scan.torn = Some(DamagedPart::new((0, end), &McapError::UnexpectedEof));
            return Ok(scan);
        }
        let mut crc = crc32fast::Hasher::new();
        crc.update(MAGIC);
        let mut at = MAGIC.len() as u64;
        // The end of the last chunk or message: a record behind it may have a wrong length.
        let mut certain = at;
        let mut is_behind_chunk = false;
        loop {
            let read = match RecordReader::new(file, at, end).next() {
                Err(error) if is_of_system(&error) => return Err(failed(error)),
                read => read,
            };
            let wrong = match &read {
                Ok(Some(record)) => resync.is_wrong(record).map_err(failed)?,
                _ => None,
            };
            let added = match wrong {
                Some(wrong) => Err((wrong, McapError::BadIndex)),
                None => scan.add_next(at, read, is_behind_chunk),
            };
            let (damaged, error) = match added {
                Ok(record) if record.is_data_end() => {
                    scan.compare(&record, crc.finalize());
                    return Ok(scan);
                }
                Ok(record) => {
                    is_behind_chunk = matches!(record.opcode, op::CHUNK | op::MESSAGE_INDEX);
                    crc.update(record.bytes());
                    at += record.len_bytes();
                    if matches!(record.opcode, op::CHUNK | op::MESSAGE) {
                        certain = at;
                    }
                    report_progress(observer, record.len_bytes())?;
                    continue;
                }
                Err(damaged) => damaged,
            };
            let next = resync.behind(certain, damaged).map_err(failed)?;
            let to = next.unwrap_or(end);
            let from = if to < at { certain } else { at };
            let part = DamagedPart::new((from, to - from), &error);
            report_progress(observer, to.saturating_sub(at))?;
            (certain, at) = (to, to);
            if next.is_none() {
                scan.is_unfinished = is_unfinished(file, from, end).map_err(failed)?;
                scan.torn = Some(part);
                return Ok(scan);
            }
            scan.damaged.push(part);
        }
    }

    /// The damaged parts. The unfinished end of a file whose recorder was killed is none.
    pub(crate) fn damaged(&self) -> impl Iterator<Item = &DamagedPart> {
        let torn = self.torn.iter().filter(|_| !self.is_unfinished);
        self.damaged.iter().chain(torn)
    }

    /// The parts that can be read of a file of `end` bytes.
    pub(crate) fn readable(&self, end: u64) -> Vec<Range<u64>> {
        let mut parts = Vec::new();
        let mut from = MAGIC.len() as u64;
        for damaged in self.damaged.iter().chain(&self.torn) {
            parts.push(from..damaged.offset);
            from = damaged.offset + damaged.bytes;
        }
        parts.push(from..end);
        parts
    }

    /// Adds the record that was read at a place, unless it is damaged.
    fn add_next(
        &mut self,
        offset: u64,
        read: McapResult<Option<RawRecord>>,
        is_behind_chunk: bool,
    ) -> Result<RawRecord, (Unreadable, McapError)> {
        let unreadable = |len_bytes, error| {
            let unreadable = Unreadable {
                offset,
                len_bytes,
                fields_len_bytes: None,
            };
            (unreadable, error)
        };
        let read = read.and_then(|it| it.ok_or(McapError::UnexpectedEof));
        let record = read.map_err(|error| unreadable(None, error))?;
        let added = match is_behind_chunk && record.is_mislabelled_index() {
            true => Err(McapError::BadIndex),
            false if record.is_data_end() => Ok(()),
            false => self.add(&record),
        };
        match added {
            Ok(()) => Ok(record),
            Err(error) => Err(unreadable(Some(record.len_bytes()), error)),
        }
    }

    /// Compares the checksum of all records with that of the record which ends the data.
    fn compare(&mut self, end: &RawRecord, calculated: u32) {
        let saved = end.bytes()[RECORD_HEAD_BYTES..].first_chunk();
        let saved = saved.map_or(0, |it| u32::from_le_bytes(*it));
        if !checksum::is_right(saved, calculated) && self.damaged.is_empty() {
            self.wrong_crc = Some(McapError::BadDataCrc { saved, calculated });
        }
    }

    /// Adds a record, or nothing of it if it is damaged.
    pub(crate) fn add(&mut self, record: &RawRecord) -> McapResult<()> {
        record.verify_kind()?;
        self.take(record)
    }

    /// As [`add`](Self::add), for a record of a summary, or one that was verified.
    pub(crate) fn take(&mut self, record: &RawRecord) -> McapResult<()> {
        let mut added = Added::default();
        match record.opcode {
            op::CHUNK => {
                self.visit(record, &mut added)?;
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
                self.visit(record, &mut added)?;
                if let Some(times) = added.times {
                    self.add_to_run(record, times);
                }
            }
            op::ATTACHMENT => self.attachments.push((record.offset, record.len_bytes())),
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

    fn visit(&mut self, record: &RawRecord, added: &mut Added) -> McapResult<()> {
        record.visit(&mut WithoutPayloads(|entry: Entry<'_>| {
            self.entry(entry, added)
        }))
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
            Entry::Message(header, len, _) => {
                let id = header.channel_id;
                if !self.summary.channels.contains_key(&id) {
                    return Err(McapError::UnknownChannel(header.sequence, id));
                }
                added.counts.entry(id).or_default().add(len);
                widen(&mut added.times, header.log_time);
            }
            Entry::Metadata(metadata) => added.metadata.push(metadata),
        }
        Ok(())
    }
}

/// Whether a file of `end` bytes, which cannot be read from this place on, ends as a recorder leaves it that is killed.
fn is_unfinished(file: &File, from: u64, end: u64) -> McapResult<bool> {
    let left = end.saturating_sub(from);
    let mut head = [0; CHUNK_SHAPE_BYTES];
    let head = &mut head[..left.min(CHUNK_SHAPE_BYTES as u64) as usize];
    of_read(file.read_exact_at(head, from))?;
    Ok(!chunk::ends_in_order(file, end) && chunk::is_unfinished(head, left))
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
