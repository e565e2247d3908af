//! Reading a bag.

use std::collections::{BTreeMap, HashMap};
use std::fs::File;
use std::os::unix::fs::FileExt;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use mcap::records::{ChunkIndex, Metadata, MetadataIndex, op};
use mcap::{Channel, MAGIC, McapError, McapResult, Summary};

use crate::chunk::{RawRecord, RecordReader, ends_in_order};
use crate::clock::ClockRelation;
use crate::content::Entry;
use crate::damaged::DamagedPart;
use crate::error::{ReadError, is_of_system};
use crate::foreign::{self, ForeignReason};
use crate::gap::{Gap, GapReason};
use crate::index;
use crate::messages::{BagFileRef, Filter, Messages};
use crate::missing::MissingTopic;
use crate::observer::{Observer, unobserved};
use crate::repeated::{NotRepeated, is_repeated};
use crate::report::{Counts, NotRecorded, Report, ReportBuilder};
use crate::rosbag2;
use crate::scan::Scan;
use crate::source::Source;
use crate::storage::free_bytes;
use crate::summary;
use crate::unpacked::{is_packed, unpack};
use crate::written_by::{WrittenBy, is_being_written};

/// A bag, open for reading. Its messages stay on the disk until they are read.
#[derive(Debug)]
pub struct Bag {
    path: PathBuf,
    file: File,
    summary: Summary,
    counts: BTreeMap<u16, Counts>,
    /// Whether the counts lack the lengths of the messages.
    lacks_bytes: bool,
    times: Option<(u64, u64)>,
    gaps: Vec<(String, Gap)>,
    missing: Vec<MissingTopic>,
    not_recorded: Vec<NotRecorded>,
    not_repeated: Vec<NotRepeated>,
    clocks: Vec<ClockRelation>,
    metadata: Vec<Metadata>,
    /// The places of messages that are in no chunk.
    runs: Vec<ChunkIndex>,
    /// The places and lengths of the attachments.
    attachments: Vec<(u64, u64)>,
    /// Whether each payload is compressed, as rosbag2 can do it.
    has_packed_payloads: bool,
    /// The damaged parts of the bags that this one was copied from.
    damaged_before: Vec<DamagedPart>,
    /// The damaged parts that were found when the bag was opened.
    damaged: Vec<DamagedPart>,
    complete: bool,
    /// The recorder that is still writing the file.
    writer: Option<WrittenBy>,
}

impl Bag {
    /// Opens a bag. Reads its summary, or else all of its records but for damaged parts.
    ///
    /// # Errors
    ///
    /// [`ReadError`], if the file cannot be read or is not an MCAP file.
    pub fn open(path: &Path) -> Result<Self, ReadError> {
        Self::open_observed(path, &mut unobserved)
    }

    /// As [`open`](Self::open). The observer is told about the chunks of a bag without a summary.
    ///
    /// # Errors
    ///
    /// [`ReadError`].
    pub fn open_observed(path: &Path, observer: &mut Observer<'_>) -> Result<Self, ReadError> {
        let (file, end) = open_file(path, observer)?;
        match Self::of_summary(path, &file, end)? {
            Some(bag) => Ok(bag),
            None => {
                let scan = scan_file(path, &file, end, observer)?;
                Ok(Self::of_scan(path, file, end, scan))
            }
        }
    }

    /// The `log_time` of the first and of the last message; `None` without a message.
    pub(crate) const fn times(&self) -> Option<(u64, u64)> {
        self.times
    }

    /// Reads the summary of a file of `end` bytes. `None` if there is none, if it is damaged, or if another program
    /// wrote it, and its [index](index::counts) lacks something.
    pub(crate) fn of_summary(
        path: &Path,
        file: &File,
        end: u64,
    ) -> Result<Option<Self>, ReadError> {
        let summary = match summary::read(file, end) {
            Ok(Some(summary)) => summary,
            Err(error) if is_of_system(&error) => return Err(ReadError::io(path, error)),
            Ok(None) | Err(_) => return Ok(None),
        };
        let mut metadata = Vec::new();
        for index in &summary.metadata_indexes {
            // A place that holds something else makes the summary worthless.
            match read_metadata(file, index, end) {
                Ok(Some(record)) if record.name == index.name => metadata.push(record),
                _ => return Ok(None),
            }
        }
        let named = metadata.iter().filter(|it| it.name == Counts::RECORD);
        let mut counts: BTreeMap<_, _> = named
            .filter_map(|it| Counts::from_metadata(&it.metadata))
            .collect();
        let Some(stats) = &summary.stats else {
            return Ok(None);
        };
        let is_counted = |(channel, messages): (&u16, &u64)| {
            counts
                .get(channel)
                .is_some_and(|it| it.messages == *messages)
        };
        let lacks_bytes = !stats.channel_message_counts.iter().all(is_counted);
        if lacks_bytes {
            match index::counts(file, &summary, end) {
                Ok(Some(indexed)) => counts = indexed,
                Err(error) if is_of_system(&error) => return Err(ReadError::io(path, error)),
                Ok(None) | Err(_) => return Ok(None),
            }
        }
        let times = (stats.message_start_time, stats.message_end_time);
        let times = (stats.message_count > 0).then_some(times);
        let file = file.try_clone().map_err(|source| ReadError::Io {
            path: path.to_owned(),
            source,
        })?;
        let attachments = summary.attachment_indexes.iter();
        let attachments = attachments.map(|it| (it.offset, it.length)).collect();
        let scan = Scan {
            summary,
            attachments,
            counts,
            times,
            metadata,
            // No message is outside of the chunks.
            ..Scan::default()
        };
        Ok(Some(Self {
            lacks_bytes,
            ..Self::new(path, file, scan, true)
        }))
    }

    /// The bag with these records.
    pub(crate) fn of_scan(path: &Path, file: File, end: u64, scan: Scan) -> Self {
        let complete = scan.torn.is_none() && ends_in_order(&file, end);
        Self::new(path, file, scan, complete)
    }

    fn new(path: &Path, file: File, scan: Scan, complete: bool) -> Self {
        // A recorder that is still there completes the file.
        let is_being_written = !complete && is_being_written(&file);
        let damaged = scan.damaged().cloned().collect();
        let named = |name| {
            let records = scan.metadata.iter().filter(move |it| it.name == name);
            records.map(|it| &it.metadata)
        };
        Self {
            path: path.to_owned(),
            file,
            gaps: named(Gap::RECORD).filter_map(Gap::from_metadata).collect(),
            missing: named(MissingTopic::RECORD)
                .filter_map(MissingTopic::from_metadata)
                .collect(),
            not_recorded: named(NotRecorded::RECORD)
                .filter_map(NotRecorded::from_metadata)
                .collect(),
            not_repeated: named(NotRepeated::RECORD)
                .filter_map(NotRepeated::from_metadata)
                .collect(),
            damaged_before: named(DamagedPart::RECORD)
                .filter_map(DamagedPart::from_metadata)
                .collect(),
            clocks: named(ClockRelation::RECORD)
                .filter_map(ClockRelation::from_metadata)
                .collect(),
            writer: named(WrittenBy::RECORD)
                .find_map(WrittenBy::from_metadata)
                .filter(|_| is_being_written),
            has_packed_payloads: rosbag2::has_packed_payloads(&scan.metadata),
            metadata: scan.metadata,
            runs: scan.runs,
            attachments: scan.attachments,
            damaged,
            summary: scan.summary,
            counts: scan.counts,
            lacks_bytes: false,
            times: scan.times,
            complete,
        }
    }

    /// The bag, with each payload compressed.
    pub(crate) fn with_packed_payloads(mut self) -> Self {
        self.has_packed_payloads = true;
        self
    }

    /// Whether each payload is compressed, as rosbag2 can do it.
    pub(crate) const fn has_packed_payloads(&self) -> bool {
        self.has_packed_payloads
    }

    /// The bag; these parts of it were found to be damaged.
    pub(crate) fn with_damaged(mut self, damaged: Vec<DamagedPart>) -> Self {
        self.damaged = damaged;
        self
    }

    /// The path of the file.
    #[must_use]
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// The summary of the bag.
    #[must_use]
    pub fn report(&self) -> Report {
        let mut report = ReportBuilder::default();
        for (id, channel) in &self.summary.channels {
            let data = Source::stated_type(channel);
            let counts = self.counts.get(id).copied().unwrap_or_default();
            match is_repeated(channel) {
                true => report.add_repeated(&channel.topic, &data, counts),
                false => report.add_channel(&channel.topic, &data, counts),
            }
        }
        if self.lacks_bytes {
            report.forget_bytes();
        }
        for (topic, gap) in &self.gaps {
            report.add_gap(topic, gap);
        }
        self.missing.iter().for_each(|it| report.add_missing(it));
        for NotRecorded(topics) in &self.not_recorded {
            report.add_not_recorded(*topics);
        }
        (self.not_repeated.iter()).for_each(|it| report.add_not_repeated(it));
        for part in self.damaged_before.iter().chain(&self.damaged) {
            report.add_damaged(part);
        }
        Report {
            writer: self.writer.clone(),
            ..report.finish(self.times, self.complete)
        }
    }

    /// Whether the recording ended in order.
    #[must_use]
    pub const fn is_complete(&self) -> bool {
        self.complete
    }

    /// The publishers that were recorded. A channel of a program of ROS 2 stands for one publisher of the node `bag`;
    /// channels of other programs have none.
    pub fn sources(
        &self,
    ) -> impl Iterator<Item = (Arc<Channel<'static>>, Result<Source, ForeignReason>)> {
        let channels = self.summary.channels.values();
        channels.map(|it| {
            let source = Source::of_channel(it).map_or_else(|| foreign::source(it), Ok);
            (Arc::clone(it), source)
        })
    }

    /// The channels.
    pub(crate) fn channels(&self) -> impl Iterator<Item = &Arc<Channel<'static>>> {
        self.summary.channels.values()
    }

    /// The relations of the wall clock to the monotonic clock: at the start, and after each step of the wall clock.
    #[must_use]
    pub fn clocks(&self) -> &[ClockRelation] {
        &self.clocks
    }

    /// The messages in the order of their `log_time`, the [repeated](crate::BagMessage::is_repeated) ones included. A
    /// compressed chunk whose content is longer than 1 GiB is damage: a recorder compresses no message above 64 KiB.
    #[must_use]
    pub fn messages(&self, filter: &Filter) -> Messages<'_> {
        let channels = &self.summary.channels;
        Messages::new(self.file(), self.places(), channels, filter)
    }

    /// The places of all messages.
    pub(crate) fn places(&self) -> impl Iterator<Item = &ChunkIndex> {
        self.summary.chunk_indexes.iter().chain(&self.runs)
    }

    /// The messages of these channels at one of the [places](Self::places).
    pub(crate) fn messages_at(
        &self,
        place: &ChunkIndex,
        channels: &HashMap<u16, Arc<Channel<'static>>>,
        filter: &Filter,
    ) -> Messages<'_> {
        let places = std::iter::once(place);
        Messages::new(self.file(), places, channels, filter)
    }

    fn file(&self) -> BagFileRef<'_> {
        BagFileRef {
            file: &self.file,
            path: &self.path,
            has_packed_payloads: self.has_packed_payloads,
        }
    }

    /// The gaps that damaged parts leave: one for each channel with fewer messages that could be `read` than the
    /// summary counts. Their times are those of the damaged chunks, or of the bag if no damaged part begins before a
    /// chunk that it has.
    pub(crate) fn gaps_of(
        &self,
        parts: &[DamagedPart],
        read: impl Fn(u16) -> u64,
    ) -> Vec<(String, Gap)> {
        let is_damaged =
            |it: &&ChunkIndex| parts.iter().any(|part| part.has(it.chunk_start_offset));
        let chunks = self.summary.chunk_indexes.iter().filter(is_damaged);
        let times = chunks.map(|it| (it.message_start_time, it.message_end_time));
        let times = times.reduce(|a, b| (a.0.min(b.0), a.1.max(b.1)));
        let Some((from_ns, to_ns)) = times.or(self.times) else {
            return Vec::new();
        };
        let gap = |channel: &Channel<'_>| {
            let counts = self.counts.get(&channel.id).copied().unwrap_or_default();
            let messages = counts.messages.checked_sub(read(channel.id))?;
            let publisher = Source::of_channel(channel).map(|it| it.publisher.to_string());
            let gap = Gap {
                publisher: publisher.unwrap_or_default(),
                from_ns,
                to_ns,
                messages,
                reason: GapReason::Damaged,
            };
            (messages > 0).then(|| (channel.topic.clone(), gap))
        };
        // Repeated messages are in no count, so none of them is lost.
        let counted = self.channels().filter(|it| !is_repeated(it));
        let mut gaps: Vec<_> = counted.filter_map(|it| gap(it)).collect();
        gaps.sort_by(|one, other| one.0.cmp(&other.0));
        gaps
    }

    /// The latched messages that the bag should begin with, and does not.
    pub(crate) fn not_repeated(&self) -> &[NotRepeated] {
        &self.not_repeated
    }

    /// The damaged parts that were found when the bag was opened.
    pub(crate) fn damaged(&self) -> &[DamagedPart] {
        &self.damaged
    }

    /// The records of the attachments, whose checksums are right.
    pub(crate) fn attachments(&self) -> impl Iterator<Item = Result<RawRecord, ReadError>> {
        self.attachments.iter().map(|&(offset, len)| {
            let read = || -> McapResult<RawRecord> {
                let end = self.file.metadata()?.len();
                let record = RecordReader::new(&self.file, offset, end).next()?;
                let record = record.filter(|it| it.len_bytes() == len);
                let record = record.ok_or(McapError::BadIndex)?;
                record.attachment()?;
                Ok(record)
            };
            read().map_err(|error| ReadError::damaged(&self.path, (offset, len), error))
        })
    }

    /// The metadata records, in their order.
    pub(crate) fn metadata(&self) -> &[Metadata] {
        &self.metadata
    }

    pub(crate) const fn summary(&self) -> &Summary {
        &self.summary
    }
}

/// Opens a file that begins like an MCAP file, or is the beginning of one: its recorder may have been killed before the
/// first byte. Returns it with its length in bytes. A file that is compressed as a whole is decompressed.
pub(crate) fn open_file(
    path: &Path,
    observer: &mut Observer<'_>,
) -> Result<(File, u64), ReadError> {
    let failed = |source| ReadError::Io {
        path: path.to_owned(),
        source,
    };
    let mut file = File::open(path).map_err(failed)?;
    if is_packed(&file) {
        file = unpack(path, &file, free_bytes, observer)?;
    }
    let end = file.metadata().map_err(failed)?.len();
    let mut magic = [0; MAGIC.len()];
    let begin = &mut magic[..MAGIC.len().min(usize::try_from(end).unwrap_or(usize::MAX))];
    if file.read_exact_at(begin, 0).is_err() || !MAGIC.starts_with(begin) {
        return Err(ReadError::NotABag { path: path.into() });
    }
    Ok((file, end))
}

/// Reads all records of a file of `end` bytes.
pub(crate) fn scan_file(
    path: &Path,
    file: &File,
    end: u64,
    observer: &mut Observer<'_>,
) -> Result<Scan, ReadError> {
    let known = summary::read(file, end).ok().flatten();
    Scan::of(path, file, end, known, observer)
}

fn read_metadata(file: &File, index: &MetadataIndex, end: u64) -> McapResult<Option<Metadata>> {
    let record = RecordReader::new(file, index.offset, end).next()?;
    let is_indexed = |it: &RawRecord| it.opcode == op::METADATA && it.len_bytes() == index.length;
    let Some(record) = record.filter(is_indexed) else {
        return Ok(None);
    };
    let mut found = None;
    record.visit(&mut |entry: Entry<'_>| {
        if let Entry::Metadata(metadata) = entry {
            found = Some(metadata);
        }
        Ok(())
    })?;
    Ok(found)
}
