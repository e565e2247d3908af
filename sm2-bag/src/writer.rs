//! Writing a bag.
//!
//! Four threads share the work of a recorder. The caller's thread takes messages from all topics in one wait set: it
//! copies messages up to 64 KiB at once, so that they hold no slot, and of each topic up to 8 longer ones wait in the
//! slots of their publishers; further ones are copied as well. A second thread prepares the records of the file, with
//! their checksums. A third one owns the file and writes the records in order (`disk.rs`), so the disk is busy while
//! the second one prepares the next message. A fourth one calls `fdatasync` once in each interval, while the third one
//! goes on writing (`syncing.rs`). The queue in front of the second thread has a limit in bytes, and at most four
//! operations wait in front of the third one. If the disk is too slow, messages are dropped before the queue and become
//! gaps with a reason, so the disk delays no publisher, unless a topic is recorded as reliable.

mod appender;
mod disk;
mod memory;
mod record;
mod syncing;

use std::collections::{BTreeMap, HashMap};
use std::io::{Seek, Write};
use std::sync::Arc;

use mcap::records::{ChunkIndex, MessageHeader, Metadata, Statistics};
use mcap::{McapResult, Summary, WriteOptions, Writer};

use self::appender::Appender;
pub(crate) use self::appender::LongMessage;
pub(crate) use self::disk::Done;
use self::memory::Memory;
use self::record::LongChunk;
use crate::clock::ClockRelation;
use crate::error::WriteError;
use crate::gap::{Gap, GapReason};
use crate::missing::MissingTopic;
use crate::profile::Profile;
use crate::repeated::{NotRepeated, mark_repeated};
use crate::report::{Counts, NotRecorded, Report, ReportBuilder, widen};
use crate::source::Source;
use crate::storage::Storage;
use crate::written_by::WrittenBy;

/// Messages up to this length are copied when they are taken, so that short messages never hold the slots of their
/// publishers, and are put into common chunks. Longer ones are chunks of their own, and wait in their slots until the
/// disk has room. In bytes.
pub(crate) const COPY_MAX_BYTES: usize = 64 << 10;
/// A file has at most so many channels. MCAP has numbers for 65,534 of them; those for repeated messages come on top.
pub(crate) const CHANNELS_MAX: usize = 60_000;
/// A chunk ends when its payloads have this length, in bytes.
const CHUNK_BYTES: usize = 1 << 20;

/// How the chunks of a bag are compressed. A recorder never compresses messages above 64 KiB: they go to the disk as
/// they are.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Compression {
    /// Not at all.
    #[default]
    None,
    /// LZ4: fast.
    Lz4,
    /// Zstandard: small.
    Zstd,
}

/// The options of the MCAP writer for all bags.
pub(crate) fn write_options(compression: Compression, profile: Profile) -> WriteOptions {
    WriteOptions::new()
        .profile(profile.name())
        .library(profile.library())
        .compression(compression.into())
        // The chunks have checksums.
        .calculate_data_section_crc(false)
}

/// Writes the counts of all channels, which a complete bag has.
pub(crate) fn write_counts<W: Write + Seek>(
    writer: &mut Writer<W>,
    counts: &BTreeMap<u16, Counts>,
) -> McapResult<()> {
    for (channel, counts) in counts {
        writer.write_metadata(&Metadata {
            name: Counts::RECORD.to_owned(),
            metadata: counts.metadata(*channel),
        })?;
    }
    Ok(())
}

/// A message to write.
#[derive(Clone, Copy, Debug)]
pub(crate) struct MessageTimes {
    pub(crate) sequence: u32,
    pub(crate) log_time: u64,
    pub(crate) publish_time: u64,
}

impl MessageTimes {
    const fn of(self, channel_id: u16) -> MessageHeader {
        let Self {
            sequence,
            log_time,
            publish_time,
        } = self;
        MessageHeader {
            channel_id,
            sequence,
            log_time,
            publish_time,
        }
    }
}

/// Writes a bag. After an error, nothing more may be written, and the bag stays without a summary.
pub(crate) struct BagWriter {
    /// Makes chunks of the short messages.
    mcap: Writer<Memory>,
    /// The records of `mcap` that are not in the file yet.
    memory: Memory,
    /// The length of the payloads in the open chunk, in bytes.
    open_bytes: usize,
    file: Appender,
    /// The chunks that `mcap` does not know.
    long_chunks: Vec<ChunkIndex>,
    channels: HashMap<Arc<Source>, u16>,
    /// The same by the address of the source, which stays in memory as long as it is here: a source has a long text,
    /// which is not hashed for each message.
    known_sources: HashMap<usize, (Arc<Source>, u16)>,
    /// The channels of messages that are repeated.
    repeated: HashMap<Arc<Source>, u16>,
    counts: BTreeMap<u16, Counts>,
    times: Option<(u64, u64)>,
    /// The gaps since the last interval, which are written at its end.
    open_gaps: BTreeMap<(Arc<str>, String, GapReason), Gap>,
    /// All gaps, with their topics.
    gaps: Vec<(Arc<str>, Gap)>,
    /// The topics that were not recorded for a time.
    missing: Vec<MissingTopic>,
    /// The number of topics that were not recorded and have no name.
    not_recorded: u64,
    not_repeated: Vec<NotRepeated>,
}

impl BagWriter {
    pub(crate) fn new(
        storage: Box<dyn Storage>,
        compression: Compression,
        clock: ClockRelation,
        by: &WrittenBy,
    ) -> Result<Self, WriteError> {
        let memory = Memory::default();
        // The header stays in memory until the first chunk ends: see `end_chunk`.
        let mcap = write_options(compression, Profile::Sm2)
            .chunk_size(None)
            .create(memory.clone())?;
        let mut writer = Self {
            mcap,
            memory,
            open_bytes: 0,
            file: Appender::start(storage)?,
            long_chunks: Vec::new(),
            channels: HashMap::new(),
            known_sources: HashMap::new(),
            repeated: HashMap::new(),
            counts: BTreeMap::new(),
            times: None,
            open_gaps: BTreeMap::new(),
            gaps: Vec::new(),
            missing: Vec::new(),
            not_recorded: 0,
            not_repeated: Vec::new(),
        };
        writer.clock(clock)?;
        writer.metadata(WrittenBy::RECORD, by.metadata())?;
        Ok(writer)
    }

    /// The length of the file so far, without its summary, in bytes.
    pub(crate) fn len_bytes(&self) -> u64 {
        self.file.end() + self.open_bytes as u64
    }

    /// The `log_time` of the first and of the last message.
    pub(crate) const fn times(&self) -> Option<(u64, u64)> {
        self.times
    }

    /// How many bytes the disk can still take; `None` if that is unknown.
    pub(crate) fn free_bytes(&mut self) -> Result<Option<u64>, WriteError> {
        Ok(self.file.free_bytes()?)
    }

    /// Writes a relation of the clocks.
    pub(crate) fn clock(&mut self, clock: ClockRelation) -> Result<(), WriteError> {
        self.metadata(ClockRelation::RECORD, clock.metadata())
    }

    /// Writes a message of at most 64 KiB.
    pub(crate) fn message(
        &mut self,
        source: &Arc<Source>,
        times: MessageTimes,
        data: &[u8],
    ) -> Result<(), WriteError> {
        let channel = self.channel(source)?;
        self.short_message(&times.of(channel), data)
    }

    /// Writes a message that an earlier bag has. It may have any length.
    pub(crate) fn repeated_message(
        &mut self,
        source: &Arc<Source>,
        times: MessageTimes,
        data: &[u8],
    ) -> Result<(), WriteError> {
        let channel = match self.repeated.get(source) {
            Some(it) => *it,
            None => {
                let added = self.add_to_file(source, true)?;
                self.repeated.insert(Arc::clone(source), added);
                added
            }
        };
        self.short_message(&times.of(channel), data)
    }

    fn short_message(&mut self, header: &MessageHeader, data: &[u8]) -> Result<(), WriteError> {
        self.mcap.write_to_known_channel(header, data)?;
        self.open_bytes += data.len();
        self.count(header, data.len());
        if self.open_bytes >= CHUNK_BYTES {
            self.end_chunk()?;
            self.file.flush()?;
        }
        Ok(())
    }

    /// Writes a message that is a chunk of its own, and gives its slot back.
    pub(crate) fn long_message(
        &mut self,
        source: &Arc<Source>,
        times: MessageTimes,
        message: LongMessage,
        done: Done,
    ) -> Result<(), WriteError> {
        let header = times.of(self.channel(source)?);
        // The messages and the channels before it stand before it in the file.
        self.end_chunk()?;
        let (start, len) = (self.file.end(), message.len());
        let payload_at = start + LongChunk::head_len(start) as u64;
        let payload = self.file.write_ahead(message, payload_at, done)?;
        let chunk = LongChunk::new(start, &header, len, payload.crc);
        self.file.append(&chunk.head);
        self.file.append_written(payload)?;
        self.file.append(&chunk.tail);
        self.long_chunks.push(chunk.index);
        self.memory.set_offset(self.file.end());
        self.count(&header, len);
        Ok(())
    }

    fn count(&mut self, header: &MessageHeader, len_bytes: usize) {
        let counts = self.counts.entry(header.channel_id).or_default();
        counts.add(len_bytes);
        widen(&mut self.times, header.log_time);
    }

    /// Ends the chunk of short messages. The gaps before them follow in the same write, so that a recorder that is
    /// killed leaves no message without the gaps before it.
    fn end_chunk(&mut self) -> Result<(), WriteError> {
        for ((topic, ..), gap) in std::mem::take(&mut self.open_gaps) {
            self.write_gap(topic, gap)?;
        }
        self.mcap.flush()?;
        let mut bytes = self.memory.take();
        if self.file.end() == 0 {
            // The file is only appended to, so the profile cannot change later. Most topics have published something
            // before the first chunk ends.
            let sources = self.channels.keys().chain(self.repeated.keys());
            let profile = Profile::of_sources(sources.map(AsRef::as_ref));
            let head = head(profile)?;
            bytes[..head.len()].copy_from_slice(&head);
        }
        self.file.append(&bytes);
        self.open_bytes = 0;
        Ok(())
    }

    /// Whether the file has no room for the channel of a publisher.
    pub(crate) fn lacks_channel(&self, source: &Arc<Source>) -> bool {
        self.channels.len() >= CHANNELS_MAX
            && !self.known_sources.contains_key(&Arc::as_ptr(source).addr())
            && !self.channels.contains_key(source)
    }

    /// The channel of a publisher.
    fn channel(&mut self, source: &Arc<Source>) -> Result<u16, WriteError> {
        let address = Arc::as_ptr(source).addr();
        if let Some((_, id)) = self.known_sources.get(&address) {
            return Ok(*id);
        }
        let id = self.add_channel(source)?;
        (self.known_sources).insert(address, (Arc::clone(source), id));
        Ok(id)
    }

    /// Adds a channel, or finds that of an equal source.
    fn add_channel(&mut self, source: &Arc<Source>) -> Result<u16, WriteError> {
        if let Some(id) = self.channels.get(source) {
            return Ok(*id);
        }
        let id = self.add_to_file(source, false)?;
        self.channels.insert(Arc::clone(source), id);
        Ok(id)
    }

    /// Writes the records of a channel.
    fn add_to_file(&mut self, source: &Source, is_repeated: bool) -> Result<u16, WriteError> {
        let (encoding, text) = source.schema_record();
        let schema = self
            .mcap
            .add_schema(source.data.name.as_str(), encoding, text)?;
        let mut metadata = source.metadata();
        if is_repeated {
            mark_repeated(&mut metadata);
        }
        let (topic, encoding) = (source.topic.as_str(), source.message_encoding());
        Ok((self.mcap).add_channel(schema, topic, &encoding, &metadata)?)
    }

    /// Writes which messages are missing.
    pub(crate) fn gap(&mut self, source: &Arc<Source>, gap: Gap) -> Result<(), WriteError> {
        // A topic whose only messages are missing has a channel, too.
        self.channel(source)?;
        let topic: Arc<str> = source.topic.as_str().into();
        let key = (Arc::clone(&topic), gap.publisher.clone(), gap.reason);
        match self.open_gaps.get_mut(&key) {
            Some(before) => {
                if !before.extend(&gap) {
                    let ended = std::mem::replace(before, gap);
                    self.write_gap(topic, ended)?;
                }
            }
            None => {
                self.open_gaps.insert(key, gap);
            }
        }
        Ok(())
    }

    fn write_gap(&mut self, topic: Arc<str>, gap: Gap) -> Result<(), WriteError> {
        self.metadata(Gap::RECORD, gap.metadata(&topic))?;
        self.gaps.push((topic, gap));
        Ok(())
    }

    /// Writes that a topic is not recorded from now on, or was not until now.
    pub(crate) fn missing(&mut self, missing: MissingTopic) -> Result<(), WriteError> {
        self.metadata(MissingTopic::RECORD, missing.metadata())?;
        self.missing.push(missing);
        Ok(())
    }

    /// Writes how many topics were not recorded and have no name.
    pub(crate) fn not_recorded(&mut self, topics: u64) -> Result<(), WriteError> {
        self.not_recorded += topics;
        self.metadata(NotRecorded::RECORD, NotRecorded(topics).metadata())
    }

    /// Writes which latched messages are not repeated.
    pub(crate) fn not_repeated(&mut self, not_repeated: NotRepeated) -> Result<(), WriteError> {
        self.metadata(NotRepeated::RECORD, not_repeated.metadata())?;
        self.not_repeated.push(not_repeated);
        Ok(())
    }

    fn metadata(
        &mut self,
        name: &str,
        metadata: BTreeMap<String, String>,
    ) -> Result<(), WriteError> {
        let name = name.to_owned();
        Ok(self.mcap.write_metadata(&Metadata { name, metadata })?)
    }

    /// Ends an interval. When [`end_sync`](Self::end_sync) returns, everything that was written before can be read
    /// after a power cut. The error may be that of the interval before.
    pub(crate) fn begin_sync(&mut self) -> Result<(), WriteError> {
        self.end_chunk()?;
        Ok(self.file.begin_sync()?)
    }

    /// Waits until everything is on the disk that was written before [`begin_sync`](Self::begin_sync).
    pub(crate) fn end_sync(&mut self) -> Result<(), WriteError> {
        Ok(self.file.end_sync()?)
    }

    /// Writes the summary, and ends the bag. Nothing more may be written.
    pub(crate) fn finish(&mut self) -> Result<Report, WriteError> {
        // The messages are safe even if the disk has no room for the summary.
        self.end_chunk()?;
        self.file.sync()?;
        write_counts(&mut self.mcap, &self.counts)?;
        self.end_chunk()?;
        let summary = self.summary()?;
        self.file.append(&record::end(self.file.end(), &summary));
        self.file.sync()?;
        let mut report = ReportBuilder::default();
        for (source, id) in &self.channels {
            let counts = self.counts.get(id).copied().unwrap_or_default();
            report.add_channel(source.topic.as_str(), &source.topic_type(), counts);
        }
        for (source, id) in &self.repeated {
            let counts = self.counts.get(id).copied().unwrap_or_default();
            report.add_repeated(source.topic.as_str(), &source.topic_type(), counts);
        }
        for (topic, gap) in &self.gaps {
            report.add_gap(topic, gap);
        }
        (self.not_repeated.iter()).for_each(|it| report.add_not_repeated(it));
        self.missing.iter().for_each(|it| report.add_missing(it));
        report.add_not_recorded(self.not_recorded);
        Ok(report.finish(self.times, true))
    }

    /// The summary of the MCAP writer, with the long messages.
    fn summary(&mut self) -> Result<Summary, WriteError> {
        // The writer puts its own summary into the memory, where it stays.
        let mut summary = self.mcap.finish()?;
        let chunks = &mut summary.chunk_indexes;
        chunks.append(&mut self.long_chunks);
        chunks.sort_by_key(|it| it.chunk_start_offset);
        let (from, to) = self.times.unwrap_or_default();
        let counts = self.counts.iter().map(|(id, it)| (*id, it.messages));
        let channel_message_counts = BTreeMap::from_iter(counts);
        summary.stats = summary.stats.map(|stats| Statistics {
            message_count: channel_message_counts.values().sum(),
            chunk_count: summary.chunk_indexes.len() as u32,
            message_start_time: from,
            message_end_time: to,
            channel_message_counts,
            ..stats
        });
        Ok(summary)
    }
}

/// The start of a bag up to the end of its header. All profiles have the same length.
fn head(profile: Profile) -> Result<Vec<u8>, WriteError> {
    let memory = Memory::default();
    let _writer = write_options(Compression::None, profile).create(memory.clone())?;
    Ok(memory.take())
}

impl From<Compression> for Option<mcap::Compression> {
    fn from(compression: Compression) -> Self {
        match compression {
            Compression::None => None,
            Compression::Lz4 => Some(mcap::Compression::Lz4),
            Compression::Zstd => Some(mcap::Compression::Zstd),
        }
    }
}
