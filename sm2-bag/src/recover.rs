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
    let (file, end) = open_file(from)?;
    let scan = Scan::of(&file, end);
    create(to, |created| {
        copy(&file, &scan, created).map_err(|error| write_error(to, error))
    })
}

/// Copies the records that a scan has read.
fn copy(from: &File, scan: &Scan, to: &File) -> Result<(), WriteError> {
    let mut writer = write_options(Compression::None).create(BufWriter::new(to))?;
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
