//! Writing chosen messages of one or more bags to a new file.

use std::collections::{BTreeMap, BTreeSet};
use std::fs::{File, OpenOptions};
use std::io::{self, BufWriter, Write};
use std::path::Path;

use mcap::records::{MessageHeader, Metadata};
use mcap::{Channel, McapResult, Writer};

use crate::bag::Bag;
use crate::damaged::{self, DamagedPart};
use crate::error::{CopyError, ReadError, WriteError};
use crate::gap::Gap;
use crate::latched::Whole;
use crate::messages::{BagMessage, Filter};
use crate::observer::{Observer, report_progress, unobserved};
use crate::profile::Profile;
use crate::repeated::{NotRepeated, is_repeated, mark_repeated};
use crate::report::{Counts, Report};
use crate::rosbag2;
use crate::shift::Shift;
use crate::writer::{Compression, write_counts, write_options};

/// Writes the messages of `bags` that pass `filter` to the new bag `to`, in the order of their `log_time`. Messages of
/// the same time keep the order of the bags. If the filter has a first time, the new bag begins with the latched state
/// as of then, marked as [repeated](BagMessage::is_repeated). Gaps are copied if their topic and a part of their time
/// pass the filter, other metadata and attachments are copied always. Damaged parts are left out: the
/// [report](Report::damaged) names them, and the messages that they had are gaps, if the filter has no times and a
/// summary counts the messages. Returns the summary of the new bag, which is removed if copying fails.
///
/// # Errors
///
/// [`CopyError`]; also if `to` exists.
pub fn copy(
    bags: &[Bag],
    to: &Path,
    filter: &Filter,
    compression: Compression,
) -> Result<Report, CopyError> {
    copy_observed(bags, to, filter, compression, &mut unobserved)
}

/// As [`copy`]. The observer is told about the payloads.
///
/// # Errors
///
/// [`CopyError`]; also if `to` exists.
pub fn copy_observed(
    bags: &[Bag],
    to: &Path,
    filter: &Filter,
    compression: Compression,
    observer: &mut Observer<'_>,
) -> Result<Report, CopyError> {
    let options = CopyOptions {
        filter,
        compression,
        metadata: &[],
        shift: Shift::default(),
    };
    copy_with(bags, to, &options, observer)
}

/// The content of a copy.
pub(crate) struct CopyOptions<'a> {
    pub(crate) filter: &'a Filter,
    pub(crate) compression: Compression,
    /// The records that the new bag begins with.
    pub(crate) metadata: &'a [Metadata],
    /// How far all times move.
    pub(crate) shift: Shift,
}

/// As [`copy_observed`].
pub(crate) fn copy_with(
    bags: &[Bag],
    to: &Path,
    options: &CopyOptions<'_>,
    observer: &mut Observer<'_>,
) -> Result<Report, CopyError> {
    let channels = bags.iter().flat_map(Bag::channels);
    let topics: BTreeSet<_> = channels.map(|it| it.topic.as_str()).collect();
    let topics = topics.iter().copied();
    if let Some(topic) = options.filter.unmatched(topics).into_iter().next() {
        return Err(CopyError::NoTopic { topic });
    }
    create(to, |file| write(bags, file, to, options, observer))
}

/// Creates the bag `to`, and removes it if writing fails. Returns its summary.
pub(crate) fn create(
    to: &Path,
    write: impl FnOnce(&File) -> Result<(), CopyError>,
) -> Result<Report, CopyError> {
    let failed = |error: io::Error| write_error(to, error.into());
    fill(&create_new(to).map_err(failed)?, to, write)
}

/// Creates a file for a bag.
pub(crate) fn create_new(path: &Path) -> io::Result<File> {
    OpenOptions::new().write(true).create_new(true).open(path)
}

/// As [`copy_with`], into the new and empty file `to`.
pub(crate) fn copy_into(
    file: &File,
    bags: &[Bag],
    to: &Path,
    options: &CopyOptions<'_>,
    observer: &mut Observer<'_>,
) -> Result<Report, CopyError> {
    fill(file, to, |file| write(bags, file, to, options, observer))
}

/// Writes the new file `to`, and removes it if that fails. Returns its summary.
fn fill(
    file: &File,
    to: &Path,
    write: impl FnOnce(&File) -> Result<(), CopyError>,
) -> Result<Report, CopyError> {
    let failed = |error: io::Error| write_error(to, error.into());
    if let Err(error) = write(file).and_then(|()| file.sync_data().map_err(failed)) {
        // The first error says more.
        let _ = std::fs::remove_file(to);
        return Err(error);
    }
    Ok(Bag::open(to)?.report())
}

pub(crate) fn write_error(path: &Path, source: WriteError) -> CopyError {
    let path = path.to_owned();
    CopyError::Write { path, source }
}

fn write(
    bags: &[Bag],
    file: &File,
    path: &Path,
    options: &CopyOptions<'_>,
    observer: &mut Observer<'_>,
) -> Result<(), CopyError> {
    let filter = options.filter;
    let failed = |error: mcap::McapError| write_error(path, error.into());
    let mut new = NewBag::begin(bags, file, options).map_err(failed)?;
    let mut damaged: Vec<Vec<DamagedPart>> = bags.iter().map(|it| it.damaged().to_vec()).collect();
    copy_attachments(bags, &mut damaged, &mut new.writer, path)?;
    let mut read = BTreeMap::<(usize, u16), u64>::new();
    for (number, found) in Whole::new(bags, filter) {
        let found = found.and_then(|it| Ok((it.is_repeated, it.read()?)));
        let (is_repeated, message) = match found {
            Ok(it) => it,
            Err(ReadError::Damaged { part, .. }) => {
                add_damaged(&mut damaged[number], part);
                continue;
            }
            Err(error) => return Err(error.into()),
        };
        (new.message(number, &message, is_repeated)).map_err(failed)?;
        *read.entry((number, message.channel.id)).or_default() += 1;
        report_progress(observer, message.data.len() as u64)?;
    }
    let has_all_times = filter.from_ns.is_none() && filter.to_ns.is_none();
    for (number, (bag, parts)) in bags.iter().zip(&damaged).enumerate() {
        let read = |channel| read.get(&(number, channel)).copied().unwrap_or_default();
        let mut gaps = bag.gaps_of(parts, read);
        let is_damaged = has_all_times && !parts.is_empty();
        gaps.retain(|(topic, _)| is_damaged && filter.has_topic(topic));
        for (_, gap) in &mut gaps {
            (gap.from_ns, gap.to_ns) = (new.shift.apply(gap.from_ns), new.shift.apply(gap.to_ns));
        }
        damaged::write(&mut new.writer, parts, &gaps).map_err(failed)?;
    }
    new.finish().map_err(failed)
}

/// Adds a damaged part, which may have been read before.
pub(crate) fn add_damaged(damaged: &mut Vec<DamagedPart>, part: DamagedPart) {
    if !damaged.contains(&part) {
        damaged.push(part);
    }
}

/// Copies the attachments of the bags. A damaged one is added to the damaged parts of its bag.
fn copy_attachments(
    bags: &[Bag],
    damaged: &mut [Vec<DamagedPart>],
    writer: &mut Writer<BufWriter<&File>>,
    path: &Path,
) -> Result<(), CopyError> {
    for (bag, damaged) in bags.iter().zip(damaged) {
        for record in bag.attachments() {
            let record = match record {
                Ok(it) => it,
                Err(ReadError::Damaged { part, .. }) => {
                    damaged.push(part);
                    continue;
                }
                Err(error) => return Err(error.into()),
            };
            let copied = record.attachment().and_then(|it| writer.attach(&it));
            copied.map_err(|error| write_error(path, error.into()))?;
        }
    }
    Ok(())
}

/// Whether a metadata record belongs into a copy.
fn is_chosen(record: &Metadata, filter: &Filter) -> bool {
    match record.name.as_str() {
        // The counts are those of the new bag.
        Counts::RECORD | NotRepeated::RECORD => false,
        Gap::RECORD => Gap::from_metadata(&record.metadata).is_none_or(|(topic, gap)| {
            filter.has_topic(&topic) && filter.overlaps(gap.from_ns, gap.to_ns)
        }),
        _ => true,
    }
}

/// The latched messages that the first bag of each publisher does not begin with. Those of later ones are in an
/// earlier one, or are named by it.
fn not_repeated<'a>(
    bags: &'a [Bag],
    filter: &'a Filter,
) -> impl Iterator<Item = &'a NotRepeated> + 'a {
    let mut sorted: Vec<_> = bags.iter().collect();
    sorted.sort_by_key(|it| it.times());
    let mut known = BTreeSet::new();
    let all = sorted.into_iter().flat_map(Bag::not_repeated);
    all.filter(move |it| filter.has_topic(&it.topic) && known.insert((&it.topic, &it.publisher)))
}

/// The bag that is written.
struct NewBag<'a> {
    writer: Writer<BufWriter<&'a File>>,
    /// The channels by the number of their bag, their number in it, and whether their messages are repeated.
    channels: BTreeMap<(usize, u16, bool), u16>,
    counts: BTreeMap<u16, Counts>,
    shift: Shift,
}

impl<'a> NewBag<'a> {
    /// Writes everything that stands before the first message.
    fn begin(bags: &[Bag], file: &'a File, options: &CopyOptions<'_>) -> McapResult<Self> {
        let filter = options.filter;
        let channels = bags.iter().flat_map(Bag::channels);
        let chosen = channels.filter(|it| filter.has_topic(&it.topic));
        let profile = Profile::of_channels(chosen.map(AsRef::as_ref));
        let mut new = Self {
            writer: write_options(options.compression, profile).create(BufWriter::new(file))?,
            channels: BTreeMap::new(),
            counts: BTreeMap::new(),
            shift: options.shift,
        };
        for record in options.metadata {
            new.writer.write_metadata(record)?;
        }
        for (number, bag) in bags.iter().enumerate() {
            // A topic without a message may have gaps.
            let chosen = bag.channels().filter(|it| filter.has_topic(&it.topic));
            for channel in chosen.filter(|it| !is_repeated(it)) {
                new.channel(number, channel, false)?;
            }
            let records = bag.metadata().iter().filter(|it| {
                // The payloads of the new bag are not compressed, as this record says.
                let is_wrong = it.name == rosbag2::RECORD && bag.has_packed_payloads();
                !is_wrong && is_chosen(it, filter)
            });
            for record in records.filter_map(|it| new.shift.record(it)) {
                new.writer.write_metadata(&record)?;
            }
        }
        for it in not_repeated(bags, filter) {
            let (name, metadata) = (NotRepeated::RECORD.to_owned(), it.metadata());
            new.writer.write_metadata(&Metadata { name, metadata })?;
        }
        Ok(new)
    }

    /// Adds a channel of a bag, or finds the same one of another bag.
    fn channel(&mut self, bag: usize, channel: &Channel<'_>, is_repeated: bool) -> McapResult<u16> {
        let key = (bag, channel.id, is_repeated);
        if let Some(known) = self.channels.get(&key) {
            return Ok(*known);
        }
        let schema = match &channel.schema {
            Some(it) => self.writer.add_schema(&it.name, &it.encoding, &it.data)?,
            None => 0,
        };
        let mut metadata = channel.metadata.clone();
        if is_repeated {
            mark_repeated(&mut metadata);
        }
        let (topic, encoding) = (&channel.topic, &channel.message_encoding);
        let added = (self.writer).add_channel(schema, topic, encoding, &metadata)?;
        self.channels.insert(key, added);
        Ok(added)
    }

    /// Writes a message of a bag.
    fn message(&mut self, bag: usize, message: &BagMessage, is_repeated: bool) -> McapResult<()> {
        let channel_id = self.channel(bag, &message.channel, is_repeated)?;
        let header = MessageHeader {
            channel_id,
            sequence: message.sequence,
            log_time: self.shift.apply(message.log_time),
            publish_time: self.shift.apply(message.publish_time),
        };
        self.writer.write_to_known_channel(&header, &message.data)?;
        let counts = self.counts.entry(channel_id).or_default();
        counts.add(message.data.len());
        Ok(())
    }

    fn finish(mut self) -> McapResult<()> {
        write_counts(&mut self.writer, &self.counts)?;
        self.writer.finish()?;
        self.writer.into_inner().flush()?;
        Ok(())
    }
}
