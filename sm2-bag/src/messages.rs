//! The messages of a bag in the order of their times.

use std::collections::{BTreeMap, BTreeSet, HashMap, VecDeque};
use std::fs::File;
use std::path::Path;
use std::sync::Arc;

use mcap::records::{ChunkIndex, MessageHeader, op};
use mcap::{Channel, McapError, McapResult};

use crate::chunk::{CHUNK_MAX_BYTES, Entry, RawRecord, RecordReader};
use crate::error::ReadError;
use crate::foreign::topic_name;
use crate::patterns::TopicPatterns;
use crate::payload::{LongPayload, Payload};
use crate::repeated::is_repeated;

/// The messages to read.
#[derive(Clone, Debug, Default)]
pub struct Filter {
    /// The topics, with or without the slash at the start that bags of ROS 2 have. Empty for all, or for those of the
    /// patterns.
    pub topics: BTreeSet<String>,
    /// Further topics, and topics that are left out.
    pub patterns: TopicPatterns,
    /// The first `log_time`.
    pub from_ns: Option<u64>,
    /// The `log_time` after the last message.
    pub to_ns: Option<u64>,
}

impl Filter {
    /// Whether messages of this topic pass.
    #[must_use]
    pub fn has_topic(&self, topic: &str) -> bool {
        let names = &self.topics;
        let is_named = names.contains(topic_name(topic)) || names.contains(topic);
        match names.is_empty() {
            true => self.patterns.choose(topic),
            false => (is_named || self.patterns.include(topic)) && !self.patterns.exclude(topic),
        }
    }

    /// The names and patterns for which none of these topics is there.
    #[must_use]
    pub fn unmatched<'a>(&self, topics: impl Iterator<Item = &'a str> + Clone) -> Vec<String> {
        let named = self.topics.iter().filter(|name| {
            let is_it = |it: &str| topic_name(it) == topic_name(name);
            !topics.clone().any(is_it)
        });
        let patterns = self.patterns.include.iter();
        let unmatched = patterns.filter(|it| !topics.clone().any(|topic| it.matches(topic)));
        let unmatched = unmatched.map(|it| it.as_str().to_owned());
        named.cloned().chain(unmatched).collect()
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

impl BagMessage {
    /// Whether the bag begins with this message only because its publisher is latched: it was published before. Then
    /// `log_time` is the time of the beginning.
    #[must_use]
    pub fn is_repeated(&self) -> bool {
        is_repeated(&self.channel)
    }
}

/// A message of a bag whose payload may still be in the file.
#[derive(Debug)]
pub(crate) struct FoundMessage<'a> {
    pub(crate) channel: Arc<Channel<'static>>,
    pub(crate) sequence: u32,
    pub(crate) log_time: u64,
    pub(crate) publish_time: u64,
    /// Whether the reader gets it only because its publisher is latched: it was published before.
    pub(crate) is_repeated: bool,
    pub(crate) payload: Payload<'a>,
}

impl FoundMessage<'_> {
    /// The message with its payload in memory.
    pub(crate) fn read(self) -> Result<BagMessage, ReadError> {
        Ok(BagMessage {
            channel: self.channel,
            sequence: self.sequence,
            log_time: self.log_time,
            publish_time: self.publish_time,
            data: self.payload.into_vec()?,
        })
    }
}

/// Reads the messages of a bag. Keeps one chunk in memory, or those whose times overlap: at most 2 GiB more than the
/// file has. A message above 64 KiB that is alone in an uncompressed chunk stays in the file until its turn. The
/// checksum of each chunk is verified, and nothing that the summary says decides how much memory is allocated.
#[derive(Debug)]
pub struct Messages<'a> {
    file: &'a File,
    path: &'a Path,
    channels: BTreeMap<u16, Arc<Channel<'static>>>,
    filter: Filter,
    /// The times of the first messages, the places and the lengths of the chunks that are not read yet, by time.
    chunks: VecDeque<(u64, u64, u64)>,
    /// The messages of the chunks that were read, by time and then by their order in the file.
    pending: BTreeMap<(u64, u64, u64), FoundMessage<'a>>,
    /// The memory of these messages, in bytes.
    pending_bytes: u64,
    /// How many messages were read.
    count: u64,
}

impl<'a> Messages<'a> {
    /// Reads the messages at these places.
    pub(crate) fn new<'p>(
        file: &'a File,
        path: &'a Path,
        places: impl Iterator<Item = &'p ChunkIndex>,
        channels: &HashMap<u16, Arc<Channel<'static>>>,
        filter: &Filter,
    ) -> Self {
        let is_chosen =
            |it: &&ChunkIndex| filter.overlaps(it.message_start_time, it.message_end_time);
        let mut chunks: Vec<_> = places
            .filter(is_chosen)
            .map(|it| {
                let (start, len) = (it.chunk_start_offset, it.chunk_length);
                (it.message_start_time, start, len)
            })
            .collect();
        chunks.sort_unstable();
        let channels = channels.iter();
        let channels = channels.filter(|it| filter.has_topic(&it.1.topic));
        Self {
            file,
            path,
            channels: channels.map(|(id, it)| (*id, Arc::clone(it))).collect(),
            filter: filter.clone(),
            chunks: chunks.into(),
            pending: BTreeMap::new(),
            pending_bytes: 0,
            count: 0,
        }
    }

    /// The next message, as [`next`](Iterator::next). Its payload may still be in the file.
    pub(crate) fn find(&mut self) -> Result<Option<FoundMessage<'a>>, ReadError> {
        loop {
            let next = self.pending.first_key_value().map(|(key, _)| key.0);
            match (next, self.chunks.front().copied()) {
                // A chunk that begins later has no earlier message.
                (Some(next), Some((start, ..))) if next >= start => {}
                (Some(_), _) => {
                    let message = self.pending.pop_first().map(|(_, message)| message);
                    self.pending_bytes -= message.as_ref().map_or(0, memory_bytes);
                    return Ok(message);
                }
                (None, Some(_)) => {}
                (None, None) => return Ok(None),
            }
            if let Some((_, offset, len)) = self.chunks.pop_front()
                && let Err(error) = self.read_chunk(offset, len)
            {
                self.forget_chunk(offset);
                return Err(ReadError::damaged(self.path, (offset, len), error));
            }
        }
    }

    /// Removes the messages of a chunk that turned out to be damaged behind them.
    fn forget_chunk(&mut self, offset: u64) {
        self.pending.retain(|(_, of, _), _| *of != offset);
        self.pending_bytes = self.pending.values().map(memory_bytes).sum();
    }

    fn read_chunk(&mut self, offset: u64, len: u64) -> McapResult<()> {
        let end = self.file.metadata()?.len();
        if let Some((header, payload)) = LongPayload::of_chunk(self.file, self.path, offset, end)? {
            return match self.is_chosen(&header) {
                true => {
                    self.add(&header, offset, Payload::Long(payload));
                    Ok(())
                }
                // Its head may be damaged.
                false => payload.verify(),
            };
        }
        let mut reader = RecordReader::new(self.file, offset, end);
        let record = reader.next()?;
        let first = record.filter(|it| match it.opcode {
            op::CHUNK => it.len_bytes() == len,
            // The first one of messages that are in no chunk.
            op::MESSAGE => it.len_bytes() <= len,
            _ => false,
        });
        let mut next = Some(first.ok_or(McapError::BadIndex)?);
        while let Some(record) = next {
            self.read_record(&record, offset, end)?;
            let after = record.offset + record.len_bytes();
            next = match after < offset.saturating_add(len) {
                true => reader.next()?,
                false => None,
            };
        }
        Ok(())
    }

    /// Adds the messages of a record of the chunk, or of the run of messages, at `offset`.
    fn read_record(&mut self, record: &RawRecord, offset: u64, end: u64) -> McapResult<()> {
        record.entries(|entry| {
            if let Entry::Message(header, data) = entry
                && self.is_chosen(&header)
            {
                self.add(&header, offset, Payload::Read(data.into_owned()));
                // Messages that are not compressed are not longer than the file.
                if self.pending_bytes > end.saturating_add(2 * CHUNK_MAX_BYTES as u64) {
                    return Err(McapError::ChunkTooLarge(self.pending_bytes));
                }
            }
            Ok(())
        })
    }

    /// Whether a message passes the filter.
    fn is_chosen(&self, header: &MessageHeader) -> bool {
        let time = header.log_time;
        self.channels.contains_key(&header.channel_id) && self.filter.overlaps(time, time)
    }

    /// Adds a message that passes the filter, from the chunk at `offset`.
    fn add(&mut self, header: &MessageHeader, offset: u64, payload: Payload<'a>) {
        self.count += 1;
        let channel = &self.channels[&header.channel_id];
        let message = FoundMessage {
            is_repeated: is_repeated(channel),
            channel: Arc::clone(channel),
            sequence: header.sequence,
            log_time: header.log_time,
            publish_time: header.publish_time,
            payload,
        };
        self.pending_bytes += memory_bytes(&message);
        let place = (header.log_time, offset, self.count);
        self.pending.insert(place, message);
    }
}

/// The memory of a message that waits for its turn, in bytes.
const fn memory_bytes(message: &FoundMessage<'_>) -> u64 {
    let len = match &message.payload {
        Payload::Read(data) => data.len(),
        Payload::Long(_) => 0,
    };
    (size_of::<FoundMessage<'_>>() + len) as u64
}

impl Iterator for Messages<'_> {
    type Item = Result<BagMessage, ReadError>;

    /// The next message. After an error, the messages of the damaged chunk are left out.
    fn next(&mut self) -> Option<Self::Item> {
        let found = self.find().transpose()?;
        Some(found.and_then(FoundMessage::read))
    }
}
