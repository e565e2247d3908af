//! Writing chosen messages of one or more bags to a new file.

use std::collections::BTreeMap;
use std::fs::{File, OpenOptions};
use std::io::{self, BufWriter, Write};
use std::path::Path;

use mcap::records::{MessageHeader, Metadata};
use mcap::{Channel, McapResult, Writer};

use crate::bag::Bag;
use crate::damaged::{self, DamagedPart};
use crate::error::{CopyError, ReadError, WriteError};
use crate::foreign::topic_name;
use crate::gap::Gap;
use crate::merged::Merged;
use crate::messages::{Filter, FoundMessage};
use crate::observer::{Observer, note, unobserved};
use crate::profile::Profile;
use crate::report::{Counts, Report};
use crate::writer::{Compression, write_counts, write_options};

/// Writes the messages of `bags` that pass `filter` to the new bag `to`, in the order of their `log_time`. Messages of
/// the same time keep the order of the bags. Gaps are copied if their topic and a part of their time pass the filter,
/// other metadata and attachments are copied always. Damaged parts are left out: the [report](Report::damaged) names
/// them, and the messages that they had are gaps, if the filter has no times and a summary counts the messages. Returns
/// the summary of the new bag, which is removed if copying fails.
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
    };
    copy_with(bags, to, &options, observer)
}

/// The content of a copy.
pub(crate) struct CopyOptions<'a> {
    pub(crate) filter: &'a Filter,
    pub(crate) compression: Compression,
    /// The records with which the new bag begins.
    pub(crate) metadata: &'a [Metadata],
}

/// As [`copy_observed`].
pub(crate) fn copy_with(
    bags: &[Bag],
    to: &Path,
    options: &CopyOptions<'_>,
    observer: &mut Observer<'_>,
) -> Result<Report, CopyError> {
    for topic in &options.filter.topics {
        let mut channels = bags.iter().flat_map(Bag::channels);
        if !channels.any(|it| topic_name(&it.topic) == topic_name(topic)) {
            let topic = topic.clone();
            return Err(CopyError::NoTopic { topic });
        }
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
    let channels = bags.iter().flat_map(Bag::channels);
    let chosen = channels.filter(|it| filter.has_topic(&it.topic));
    let profile = Profile::of_channels(chosen.map(AsRef::as_ref));
    let writer = write_options(options.compression, profile).create(BufWriter::new(file));
    let mut new = NewBag {
        writer: writer.map_err(failed)?,
        channels: BTreeMap::new(),
        counts: BTreeMap::new(),
    };
    for record in options.metadata {
        new.writer.write_metadata(record).map_err(failed)?;
    }
    for (number, bag) in bags.iter().enumerate() {
        // A topic without a message may have gaps.
        for channel in bag.channels().filter(|it| filter.has_topic(&it.topic)) {
            new.add_channel(number, channel).map_err(failed)?;
        }
        let records = bag.metadata().iter().filter(|it| is_chosen(it, filter));
        for record in records {
            new.writer.write_metadata(record).map_err(failed)?;
        }
    }
    let mut damaged: Vec<Vec<DamagedPart>> = bags.iter().map(|it| it.damaged().to_vec()).collect();
    copy_attachments(bags, &mut damaged, &mut new.writer, path)?;
    let mut read = BTreeMap::<(usize, u16), u64>::new();
    for (number, found) in Merged::new(bags, filter) {
        let message = match found.and_then(FoundMessage::read) {
            Ok(it) => it,
            Err(ReadError::Damaged { part, .. }) => {
                damaged[number].push(part);
                continue;
            }
            Err(error) => return Err(error.into()),
        };
        let channel = (number, message.channel.id);
        let header = MessageHeader {
            channel_id: new.channels[&channel],
            sequence: message.sequence,
            log_time: message.log_time,
            publish_time: message.publish_time,
        };
        new.message(&header, &message.data).map_err(failed)?;
        *read.entry(channel).or_default() += 1;
        note(observer, message.data.len() as u64)?;
    }
    let has_all_times = filter.from_ns.is_none() && filter.to_ns.is_none();
    for (number, (bag, parts)) in bags.iter().zip(&damaged).enumerate() {
        let read = |channel| read.get(&(number, channel)).copied().unwrap_or_default();
        let mut gaps = bag.gaps_of(parts, read);
        gaps.retain(|(topic, _)| has_all_times && filter.has_topic(topic));
        damaged::write(&mut new.writer, parts, &gaps).map_err(failed)?;
    }
    new.finish().map_err(failed)
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
        Counts::RECORD => false,
        Gap::RECORD => Gap::from_metadata(&record.metadata).is_none_or(|(topic, gap)| {
            filter.has_topic(&topic) && filter.overlaps(gap.from_ns, gap.to_ns)
        }),
        _ => true,
    }
}

/// The bag that is written.
struct NewBag<'a> {
    writer: Writer<BufWriter<&'a File>>,
    /// The channels by the number of their bag and their number in it.
    channels: BTreeMap<(usize, u16), u16>,
    counts: BTreeMap<u16, Counts>,
}

impl NewBag<'_> {
    /// Adds a channel of a bag, or finds the same one of another bag.
    fn add_channel(&mut self, bag: usize, channel: &Channel<'_>) -> McapResult<()> {
        let schema = match &channel.schema {
            Some(it) => self.writer.add_schema(&it.name, &it.encoding, &it.data)?,
            None => 0,
        };
        let (topic, encoding) = (&channel.topic, &channel.message_encoding);
        let added = (self.writer).add_channel(schema, topic, encoding, &channel.metadata)?;
        self.channels.insert((bag, channel.id), added);
        Ok(())
    }

    fn message(&mut self, header: &MessageHeader, data: &[u8]) -> McapResult<()> {
        self.writer.write_to_known_channel(header, data)?;
        let counts = self.counts.entry(header.channel_id).or_default();
        counts.add(data.len());
        Ok(())
    }

    fn finish(mut self) -> McapResult<()> {
        write_counts(&mut self.writer, &self.counts)?;
        self.writer.finish()?;
        self.writer.into_inner().flush()?;
        Ok(())
    }
}
