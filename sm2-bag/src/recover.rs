//! Writing the readable part of a damaged bag to a new file.

use std::collections::BTreeMap;
use std::fs::File;
use std::io::{BufWriter, Seek, Write};
use std::path::Path;

use mcap::records::op;
use mcap::{McapResult, Writer};

use crate::bag::{Bag, open_file, scan_file};
use crate::bag_files::BagFiles;
use crate::chunk::RecordReader;
use crate::content::Entry;
use crate::copy::{copy_observed, create, write_error};
use crate::damaged;
use crate::error::{CopyError, WriteError};
use crate::messages::Filter;
use crate::observer::{Observer, report_progress, unobserved};
use crate::profile::Profile;
use crate::report::{Counts, Report};
use crate::scan::Scan;
use crate::writer::{Compression, write_counts, write_options};

/// Copies everything of the bag `from` (a file, or a folder as [`BagFiles`] describes it) but its damaged parts to the
/// new bag `to`, with a summary. The [report](Report::damaged) names these parts. The messages that they had are gaps,
/// if the summary of `from` counts them. Returns the summary of the new bag, which is removed if copying fails.
///
/// # Errors
///
/// [`CopyError`]; also if `to` exists.
pub fn recover(from: &Path, to: &Path) -> Result<Report, CopyError> {
    recover_observed(from, to, &mut unobserved)
}

/// As [`recover`]. The readable part is read twice.
///
/// # Errors
///
/// [`CopyError`]; also if `to` exists.
pub fn recover_observed(
    from: &Path,
    to: &Path,
    observer: &mut Observer<'_>,
) -> Result<Report, CopyError> {
    let files = BagFiles::find(from)?;
    if !files.is_one() {
        let bags = files.open(observer)?;
        return copy_observed(&bags, to, &Filter::default(), Compression::None, observer);
    }
    let from = files.paths().first().map_or(from, AsRef::as_ref);
    let (file, end) = open_file(from, observer)?;
    let scan = scan_file(from, &file, end, observer)?;
    let described = Bag::of_summary(from, &file, end)?;
    create(to, |created| {
        let mut stopped = Ok(());
        let copied = copy(&file, &scan, described.as_ref(), created, &mut |bytes| {
            stopped = report_progress(observer, bytes);
            stopped.is_ok()
        });
        stopped?;
        copied.map_err(|error| write_error(to, error))
    })
}

/// Copies the records that a scan has read, as long as `goes_on` returns true, which gets the length of each record.
/// The bag as its summary describes it says how many messages are missing.
pub(crate) fn copy(
    from: &File,
    scan: &Scan,
    summary: Option<&Bag>,
    to: &File,
    goes_on: &mut dyn FnMut(u64) -> bool,
) -> Result<(), WriteError> {
    let channels = &scan.summary.channels;
    let profile = Profile::of_channels(channels.values().map(AsRef::as_ref));
    let mut writer = write_options(Compression::None, profile).create(BufWriter::new(to))?;
    // A damaged part may have the record of a channel that is described nowhere else but in the summary.
    let damaged: Vec<_> = scan.damaged().cloned().collect();
    if !damaged.is_empty() {
        write_channels(&mut writer, scan)?;
    }
    for part in scan.readable(from.metadata()?.len()) {
        let mut reader = RecordReader::new(from, part.start, part.end);
        while let Some(record) = reader.next()? {
            match record.opcode {
                op::DATA_END => break,
                op::CHUNK | op::SCHEMA | op::CHANNEL | op::MESSAGE | op::METADATA => {
                    record.visit(&mut |entry: Entry<'_>| write_entry(&mut writer, entry))?;
                }
                op::ATTACHMENT => writer.attach(&record.attachment()?)?,
                _ => {}
            }
            if !goes_on(record.len_bytes()) {
                return Ok(());
            }
        }
    }
    let read = |channel| scan.counts.get(&channel).map_or(0, |it| it.messages);
    let gaps = summary.map(|bag| bag.gaps_of(&damaged, read));
    damaged::write(&mut writer, &damaged, &gaps.unwrap_or_default())?;
    write_counts(&mut writer, &scan.counts)?;
    writer.finish()?;
    writer.into_inner().flush()?;
    Ok(())
}

/// Writes all schemas and channels, in the order of their numbers.
fn write_channels<W: Write + Seek>(writer: &mut Writer<W>, scan: &Scan) -> McapResult<()> {
    for schema in BTreeMap::from_iter(&scan.summary.schemas).into_values() {
        writer.add_schema_with_id(schema.id, &schema.name, &schema.encoding, &schema.data)?;
    }
    for it in BTreeMap::from_iter(&scan.summary.channels).into_values() {
        let schema = it.schema.as_ref().map_or(0, |it| it.id);
        let (topic, encoding) = (&it.topic, &it.message_encoding);
        writer.add_channel_with_id(it.id, schema, topic, encoding, &it.metadata)?;
    }
    Ok(())
}

fn write_entry<W: Write + Seek>(writer: &mut Writer<W>, entry: Entry<'_>) -> McapResult<()> {
    match entry {
        Entry::Schema(it) => {
            writer.add_schema_with_id(it.id, &it.name, &it.encoding, &it.data)?;
        }
        Entry::Channel(it) => {
            let (id, schema) = (it.id, it.schema_id);
            let (topic, encoding) = (&it.topic, &it.message_encoding);
            writer.add_channel_with_id(id, schema, topic, encoding, &it.metadata)?;
        }
        Entry::Message(header, _, data) => {
            writer.write_to_known_channel(&header, &data.unwrap_or_default())?;
        }
        // The counts are those of the new bag.
        Entry::Metadata(it) if it.name == Counts::RECORD => {}
        Entry::Metadata(it) => writer.write_metadata(&it)?,
    }
    Ok(())
}

#[cfg(test)]
mod tests;
