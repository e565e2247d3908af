//! The messages of a bag in the order of their times.

use std::collections::{BTreeMap, BTreeSet, HashMap};
use std::fs::File;
use std::path::Path;
use std::sync::Arc;

use mcap::records::{ChunkIndex, MessageHeader, op};
use mcap::{Channel, McapError, McapResult};

use crate::chunk::RecordReader;
use crate::content::{Entry, Visit};
use crate::error::ReadError;
use crate::foreign::topic_name;
use crate::patterns::TopicPatterns;
use crate::payload::{LongPayload, PackedPayload, Payload};
use crate::repeated::is_repeated;

/// How much memory the messages of a bag that wait for their turn may have, in bytes.
const PENDING_MAX_BYTES: u64 = 64 << 20;

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

    /// The names and patterns that fit none of these topics.
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

/// Where a message stands in the order of a bag: its `log_time`, the place of its chunk, and its number in the chunk.
type Place = (u64, u64, u64);

/// The file of a bag, for readers of its messages.
#[derive(Clone, Copy, Debug)]
pub(crate) struct BagFileRef<'a> {
    pub(crate) file: &'a File,
    pub(crate) path: &'a Path,
    /// Whether each payload is compressed, as rosbag2 can do it.
    pub(crate) has_packed_payloads: bool,
}

/// Reads the messages of a bag.
///
/// The payloads that wait for their turn have at most 64 MiB in memory, or else there is one of them. If chunks
/// overlap, or if one is longer than that, the last messages are dropped, and their chunk is read again when their turn
/// comes. In addition, the chunk that is being read is in memory as it is in the file. A message above 64 KiB that is
/// alone in an uncompressed chunk stays in the file until its turn. The checksum of each chunk is verified, and nothing
/// that the summary says decides how much memory is allocated.
#[derive(Debug)]
pub struct Messages<'a> {
    bag: BagFileRef<'a>,
    channels: BTreeMap<u16, Arc<Channel<'static>>>,
    filter: Filter,
    /// The lengths of the chunks that have to be read, by the first place that a message of it can have.
    chunks: BTreeMap<Place, u64>,
    /// The places in `chunks` of those that were read, and have to be read again, by their places in the file.
    again: BTreeMap<u64, Place>,
    /// The messages of the chunks that were read, with the lengths of their chunks.
    pending: BTreeMap<Place, (FoundMessage<'a>, u64)>,
    /// The memory of these messages, in bytes.
    pending_bytes: u64,
    pending_max_bytes: u64,
}

impl<'a> Messages<'a> {
    /// Reads the messages at these places.
    pub(crate) fn new<'p>(
        bag: BagFileRef<'a>,
        places: impl Iterator<Item = &'p ChunkIndex>,
        channels: &HashMap<u16, Arc<Channel<'static>>>,
        filter: &Filter,
    ) -> Self {
        let is_chosen =
            |it: &&ChunkIndex| filter.overlaps(it.message_start_time, it.message_end_time);
        let chunks = places.filter(is_chosen).map(|it| {
            let place = (it.message_start_time, it.chunk_start_offset, 0);
            (place, it.chunk_length)
        });
        let channels = channels.iter();
        let channels = channels.filter(|it| filter.has_topic(&it.1.topic));
        Self {
            bag,
            channels: channels.map(|(id, it)| (*id, Arc::clone(it))).collect(),
            filter: filter.clone(),
            chunks: chunks.collect(),
            again: BTreeMap::new(),
            pending: BTreeMap::new(),
            pending_bytes: 0,
            pending_max_bytes: PENDING_MAX_BYTES,
        }
    }

    /// The next message, as [`next`](Iterator::next). Its payload may still be in the file.
    pub(crate) fn find(&mut self) -> Result<Option<FoundMessage<'a>>, ReadError> {
        loop {
            let next = self.pending.first_key_value().map(|(place, _)| *place);
            let chunk = self.chunks.first_key_value().map(|(place, _)| *place);
            if let Some(next) = next
                && chunk.is_none_or(|it| next < it)
            {
                // A chunk that begins later has no earlier message.
                return Ok(self.pop(next));
            }
            let Some((from, len)) = self.chunks.pop_first() else {
                return Ok(None);
            };
            let (_, offset, _) = from;
            self.again.remove(&offset);
            if let Err(error) = self.read_chunk(from, len) {
                self.forget_chunk(offset);
                return Err(ReadError::damaged(self.bag.path, (offset, len), error));
            }
        }
    }

    fn pop(&mut self, place: Place) -> Option<FoundMessage<'a>> {
        let (message, _) = self.pending.remove(&place)?;
        self.pending_bytes -= memory_bytes(&message);
        Some(message)
    }

    /// Removes the messages of a chunk that turned out to be damaged behind them.
    fn forget_chunk(&mut self, offset: u64) {
        self.pending.retain(|(_, of, _), _| *of != offset);
        let pending = self.pending.values();
        self.pending_bytes = pending.map(|(it, _)| memory_bytes(it)).sum();
        if let Some(place) = self.again.remove(&offset) {
            self.chunks.remove(&place);
        }
    }

    /// Reads the messages of a chunk of `len` bytes, or of a run of messages, that stand at `from` or later.
    fn read_chunk(&mut self, from: Place, len: u64) -> McapResult<()> {
        let BagFileRef { file, path, .. } = self.bag;
        let (_, offset, _) = from;
        let end = file.metadata()?.len();
        if !self.bag.has_packed_payloads
            && let Some((header, payload)) = LongPayload::of_chunk(file, path, offset, end)?
        {
            return match self.is_chosen(&header) {
                true => {
                    let place = (header.log_time, offset, 0);
                    self.add(place, &header, Payload::Long(payload), len);
                    Ok(())
                }
                // Its head may be damaged.
                false => payload.verify(),
            };
        }
        let mut reader = RecordReader::new(file, offset, end);
        let record = reader.next()?;
        let first = record.filter(|it| match it.opcode {
            op::CHUNK => it.len_bytes() == len,
            // The first one of messages that are in no chunk.
            op::MESSAGE => it.len_bytes() <= len,
            _ => false,
        });
        let mut reading = Reading {
            messages: self,
            from,
            chunk_len: len,
            place: (0, offset, 0),
            number: 0,
        };
        let mut next = Some(first.ok_or(McapError::BadIndex)?);
        while let Some(record) = next {
            record.visit(&mut reading)?;
            let after = record.offset + record.len_bytes();
            next = match after < offset.saturating_add(len) {
                true => reader.next()?,
                false => None,
            };
        }
        Ok(())
    }

    /// Whether a message passes the filter.
    fn is_chosen(&self, header: &MessageHeader) -> bool {
        let time = header.log_time;
        self.channels.contains_key(&header.channel_id) && self.filter.overlaps(time, time)
    }

    /// Whether there is room for a payload, if later messages make room.
    fn has_room(&self, place: Place, len: usize) -> bool {
        let last = self.pending.last_key_value().map(|(place, _)| *place);
        let all_bytes = self.pending_bytes.saturating_add(len as u64);
        all_bytes <= self.pending_max_bytes || last.is_none_or(|last| place < last)
    }

    /// Adds a message that passes the filter, and drops the last ones if there is no room for them.
    fn add(&mut self, place: Place, header: &MessageHeader, payload: Payload<'a>, chunk_len: u64) {
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
        self.pending.insert(place, (message, chunk_len));
        while self.pending_bytes > self.pending_max_bytes
            && self.pending.len() > 1
            && let Some((place, (message, chunk_len))) = self.pending.pop_last()
        {
            self.pending_bytes -= memory_bytes(&message);
            self.put_off(place, chunk_len);
        }
    }

    /// Reads the chunk of the message at this place again when its turn comes.
    fn put_off(&mut self, place: Place, chunk_len: u64) {
        let (_, offset, _) = place;
        let known = self.again.get(&offset).copied();
        if known.is_some_and(|known| known <= place) {
            return;
        }
        if let Some(known) = known {
            self.chunks.remove(&known);
        }
        self.again.insert(offset, place);
        self.chunks.insert(place, chunk_len);
    }
}

/// Adds the messages of a chunk, or of a run of messages.
struct Reading<'m, 'a> {
    messages: &'m mut Messages<'a>,
    from: Place,
    chunk_len: u64,
    /// The place of the last message.
    place: Place,
    /// The number of the next message.
    number: u64,
}

impl Visit for Reading<'_, '_> {
    fn wants(&mut self, header: &MessageHeader, len: usize) -> bool {
        let (_, offset, _) = self.place;
        self.place = (header.log_time, offset, self.number);
        self.number += 1;
        if self.place < self.from || !self.messages.is_chosen(header) {
            return false;
        }
        let has_room = self.messages.has_room(self.place, len);
        if !has_room {
            self.messages.put_off(self.place, self.chunk_len);
        }
        has_room
    }

    fn entry(&mut self, entry: Entry<'_>) -> McapResult<()> {
        if let Entry::Message(header, _, Some(data)) = entry {
            let data = data.into_owned();
            let bag = self.messages.bag;
            let payload = match bag.has_packed_payloads {
                true => {
                    let chunk = (self.place.1, self.chunk_len);
                    Payload::Packed(PackedPayload::new(data, bag.path, chunk))
                }
                false => Payload::Read(data),
            };
            (self.messages).add(self.place, &header, payload, self.chunk_len);
        }
        Ok(())
    }
}

/// The memory of a message that waits for its turn, in bytes.
const fn memory_bytes(message: &FoundMessage<'_>) -> u64 {
    (size_of::<FoundMessage<'_>>() + message.payload.memory_bytes()) as u64
}

impl Iterator for Messages<'_> {
    type Item = Result<BagMessage, ReadError>;

    /// The next message. After an error, the messages of the damaged chunk are left out.
    fn next(&mut self) -> Option<Self::Item> {
        let found = self.find().transpose()?;
        Some(found.and_then(FoundMessage::read))
    }
}

#[cfg(test)]
mod tests;
