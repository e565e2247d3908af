//! Reading the summary at the end of a bag.

use std::fs::File;

use mcap::records::{Record, op};
use mcap::{MAGIC, McapError, McapResult, Summary};

use crate::chunk::{RECORD_HEAD_BYTES, RecordReader};
use crate::scan::Scan;

/// The length of the footer, in bytes.
const FOOTER_BYTES: u64 = RECORD_HEAD_BYTES as u64 + 20;

/// Reads the summary of a file with this length; `None` if it has none. The reader of the crate `mcap` would parse
/// attachments, which panics on short ones.
pub(crate) fn read(file: &File, end: u64) -> McapResult<Option<Summary>> {
    let magic_at = end.checked_sub(MAGIC.len() as u64);
    let footer_at = magic_at.and_then(|at| at.checked_sub(FOOTER_BYTES));
    let (Some(magic_at), Some(footer_at)) = (magic_at, footer_at) else {
        return Err(McapError::UnexpectedEof);
    };
    let footer = RecordReader::new(file, footer_at, magic_at).next()?;
    let footer = footer.filter(|it| it.opcode == op::FOOTER);
    let Record::Footer(footer) = footer.ok_or(McapError::BadFooter)?.parse()? else {
        return Err(McapError::BadFooter);
    };
    if footer.summary_start == 0 {
        return Ok(None);
    }
    let mut scan = Scan::default();
    let mut reader = RecordReader::new(file, footer.summary_start, footer_at);
    while let Some(record) = reader.next()? {
        match record.opcode {
            op::SCHEMA | op::CHANNEL => scan.add(&record)?,
            op::CHUNK_INDEX | op::METADATA_INDEX | op::STATISTICS => match record.parse()? {
                Record::ChunkIndex(it) => scan.summary.chunk_indexes.push(it),
                Record::MetadataIndex(it) => scan.summary.metadata_indexes.push(it),
                Record::Statistics(it) => scan.summary.stats = Some(it),
                _ => {}
            },
            _ => {}
        }
    }
    let Summary {
        chunk_indexes,
        metadata_indexes,
        ..
    } = &mut scan.summary;
    chunk_indexes.sort_unstable_by_key(|it| it.chunk_start_offset);
    metadata_indexes.sort_unstable_by_key(|it| it.offset);
    let chunks = chunk_indexes.iter();
    let records = metadata_indexes.iter();
    if overlap(chunks.map(|it| (it.chunk_start_offset, it.chunk_length)))
        || overlap(records.map(|it| (it.offset, it.length)))
    {
        return Err(McapError::BadIndex);
    }
    Ok(Some(scan.summary))
}

/// Whether places overlap that are sorted by their offsets. Their records could be longer than the file in total, if
/// each was read.
fn overlap(places: impl Iterator<Item = (u64, u64)>) -> bool {
    let mut end = 0;
    for (offset, len) in places {
        if offset < end {
            return true;
        }
        end = offset.saturating_add(len);
    }
    false
}
