//! Writing the readable part of a damaged bag to a new file.

use std::fs::File;
use std::io::{BufWriter, Seek, Write};
use std::path::Path;

use mcap::records::op;
use mcap::{MAGIC, McapResult, Writer};

use crate::bag::open_file;
use crate::chunk::{Entry, RecordReader};
use crate::copy::{create, write_error};
use crate::error::{CopyError, WriteError};
use crate::observer::{Observer, note, unobserved};
use crate::profile::Profile;
use crate::report::{Counts, Report};
use crate::scan::Scan;
use crate::writer::{Compression, write_counts, write_options};

/// Copies everything before the first damage of the bag `from` to the new bag `to`, with a summary. Returns the summary
/// of the new bag, which is removed if copying fails.
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
    let (file, end) = open_file(from)?;
    let scan = Scan::of(&file, end, observer)?;
    create(to, |created| {
        let mut stopped = Ok(());
        let copied = copy(&file, &scan, created, &mut |bytes| {
            stopped = note(observer, bytes);
            stopped.is_ok()
        });
        stopped?;
        copied.map_err(|error| write_error(to, error))
    })
}

/// Copies the records that a scan has read, as long as `goes_on` returns true, which gets the length of each record.
pub(crate) fn copy(
    from: &File,
    scan: &Scan,
    to: &File,
    goes_on: &mut dyn FnMut(u64) -> bool,
) -> Result<(), WriteError> {
    let profile = Profile::of_channels(scan.summary.channels.values().map(AsRef::as_ref));
    let mut writer = write_options(Compression::None, profile).create(BufWriter::new(to))?;
    let end = match &scan.damage {
        Some((offset, _)) => *offset,
        None => from.metadata()?.len(),
    };
    let mut reader = RecordReader::new(from, MAGIC.len() as u64, end);
    while let Some(record) = reader.next()? {
        match record.opcode {
            op::DATA_END => break,
            op::CHUNK | op::SCHEMA | op::CHANNEL | op::MESSAGE | op::METADATA => {
                record.entries(|entry| write_entry(&mut writer, entry))?;
            }
            _ => {}
        }
        if !goes_on(record.len_bytes()) {
            return Ok(());
        }
    }
    write_counts(&mut writer, &scan.counts)?;
    writer.finish()?;
    writer.into_inner().flush()?;
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
        Entry::Message(header, data) => writer.write_to_known_channel(&header, &data)?,
        // The counts are those of the new bag.
        Entry::Metadata(it) if it.name == Counts::RECORD => {}
        Entry::Metadata(it) => writer.write_metadata(&it)?,
    }
    Ok(())
}
