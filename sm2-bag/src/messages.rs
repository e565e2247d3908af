//! The messages of a bag in the order of their times.

use std::collections::{BTreeMap, BTreeSet, VecDeque};
use std::fs::File;
use std::path::Path;
use std::sync::Arc;

use mcap::records::{ChunkIndex, op};
use mcap::{Channel, McapError, McapResult, Summary};

use crate::chunk::{Entry, RecordReader};
use crate::error::ReadError;

/// The messages to read.
#[derive(Clone, Debug, Default)]
pub struct Filter {
    /// The topics; empty for all.
    pub topics: BTreeSet<String>,
    /// The first `log_time`.
    pub from_ns: Option<u64>,
    /// The `log_time` after the last message.
    pub to_ns: Option<u64>,
}

impl Filter {
    /// Whether messages of this topic pass.
    pub(crate) fn has_topic(&self, topic: &str) -> bool {
        self.topics.is_empty() || self.topics.contains(topic)
    }

    /// Whether a part of the time from `first_ns` to `last_ns`, both included, passes.
    pub(crate) fn overlaps(&self, first_ns: u64, last_ns: u64) -> bool {
        self.from_ns.is_none_or(|from| from <= last_ns) && self.to_ns.is_none_or(|to| first_ns < to)
    }
}

/// A message of a bag.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct BagMessage {
    /// The channel.
    pub channel: Arc<Channel<'static>>,
    /// The low half of the publisher's number of the message.
    pub sequence: u32,
    /// The time of reception, in nanoseconds of the wall clock.
    pub log_time: u64,
    /// The time of publication, in nanoseconds of the wall clock.
    pub publish_time: u64,
    /// The payload.
    pub data: Vec<u8>,
}

/// Reads the messages of a bag. Keeps one chunk in memory, or those whose times overlap. The checksum of each chunk is
/// verified, and nothing that the summary says decides how much memory is allocated.
#[derive(Debug)]
pub struct Messages<'a> {
    file: &'a File,
    path: &'a Path,
    channels: BTreeMap<u16, Arc<Channel<'static>>>,
    filter: Filter,
    /// The times of the first messages and the places of the chunks that are not read yet, by time.
    chunks: VecDeque<(u64, u64)>,
    /// The messages of the chunks that were read, by time and then by their order in the file.
    pending: BTreeMap<(u64, u64), BagMessage>,
    /// How many messages were read.
    count: u64,
}

impl<'a> Messages<'a> {
    pub(crate) fn new(file: &'a File, path: &'a Path, summary: &Summary, filter: &Filter) -> Self {
        let is_chosen =
            |it: &&ChunkIndex| filter.overlaps(it.message_start_time, it.message_end_time);
        let chosen = summary.chunk_indexes.iter().filter(is_chosen);
        let mut chunks: Vec<_> = chosen
            .map(|it| (it.message_start_time, it.chunk_start_offset))
            .collect();
        chunks.sort_unstable();
        let channels = summary.channels.iter();
        let channels = channels.filter(|it| filter.has_topic(&it.1.topic));
        Self {
            file,
            path,
            channels: channels.map(|(id, it)| (*id, Arc::clone(it))).collect(),
            filter: filter.clone(),
            chunks: chunks.into(),
            pending: BTreeMap::new(),
            count: 0,
        }
    }

    fn read(&mut self) -> McapResult<Option<BagMessage>> {
        loop {
            let next = self.pending.first_entry();
            match (next, self.chunks.front().copied()) {
                // A chunk that begins later has no earlier message.
                (Some(next), None) => return Ok(Some(next.remove())),
                (Some(next), Some((start, _))) if next.key().0 < start => {
                    return Ok(Some(next.remove()));
                }
                (_, Some((_, offset))) => {
                    self.chunks.pop_front();
                    self.read_chunk(offset)?;
                }
                (None, None) => return Ok(None),
            }
        }
    }

    fn read_chunk(&mut self, offset: u64) -> McapResult<()> {
        let end = self.file.metadata()?.len();
        let record = RecordReader::new(self.file, offset, end).next()?;
        let record = record.filter(|it| it.opcode == op::CHUNK);
        record.ok_or(McapError::BadIndex)?.entries(|entry| {
            let Entry::Message(header, data) = entry else {
                return Ok(());
            };
            self.count += 1;
            let time = header.log_time;
            if let Some(channel) = self.channels.get(&header.channel_id)
                && self.filter.overlaps(time, time)
            {
                let message = BagMessage {
                    channel: Arc::clone(channel),
                    sequence: header.sequence,
                    log_time: time,
                    publish_time: header.publish_time,
                    data: data.into_owned(),
                };
                self.pending.insert((time, self.count), message);
            }
            Ok(())
        })
    }
}

impl Iterator for Messages<'_> {
    type Item = Result<BagMessage, ReadError>;

    /// The next message. After an error, the messages of the damaged chunk are left out.
    fn next(&mut self) -> Option<Self::Item> {
        let path = self.path;
        let read = self.read();
        read.map_err(|source| ReadError::of(path, source))
            .transpose()
    }
}
