//! Reading the summary at the end of a bag.

use std::fs::File;
use std::os::unix::fs::FileExt;

use crc32fast::Hasher;
use mcap::records::{Footer, Record, op};
use mcap::{MAGIC, McapError, McapResult, Summary};

use crate::chunk::{RECORD_HEAD_BYTES, RecordReader, hash_part, of_read};
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
    let mut magic = [0; MAGIC.len()];
    of_read(file.read_exact_at(&mut magic, magic_at))?;
    if magic != MAGIC {
        return Err(McapError::BadMagic);
    }
    let footer = RecordReader::new(file, footer_at, magic_at).next()?;
    let footer = footer.filter(|it| it.opcode == op::FOOTER);
    let Record::Footer(footer) = footer.ok_or(McapError::BadFooter)?.parse()? else {
        return Err(McapError::BadFooter);
    };
    if footer.summary_start == 0 {
        // Some writers compute the checksum of the footer alone.
        let from = footer_at;
        return match verify(file, from, &footer, magic_at) {
            Err(McapError::BadSummaryCrc { .. }) => Err(McapError::BadFooter),
            verified => verified.map(|()| None),
        };
    }
    let from = footer.summary_start;
    verify(file, from, &footer, magic_at)?;
    let mut scan = Scan::default();
    let mut reader = RecordReader::new(file, footer.summary_start, footer_at);
    while let Some(record) = reader.next()? {
        match record.opcode {
            op::SCHEMA | op::CHANNEL => scan.take(&record)?,
            op::CHUNK_INDEX | op::METADATA_INDEX | op::ATTACHMENT_INDEX | op::STATISTICS => {
                match record.parse()? {
                    Record::ChunkIndex(it) => scan.summary.chunk_indexes.push(it),
                    Record::AttachmentIndex(it) => scan.summary.attachment_indexes.push(it),
                    Record::MetadataIndex(it) => scan.summary.metadata_indexes.push(it),
                    Record::Statistics(it) => scan.summary.stats = Some(it),
                    _ => {}
                }
            }
            _ => {}
        }
    }
    match sort_and_compare(&mut scan.summary) {
        true => Ok(Some(scan.summary)),
        false => Err(McapError::BadIndex),
    }
}

/// Sorts the indexes by their places. Returns whether neither chunks nor records of metadata overlap.
fn sort_and_compare(summary: &mut Summary) -> bool {
    let Summary {
        chunk_indexes,
        metadata_indexes,
        ..
    } = summary;
    chunk_indexes.sort_unstable_by_key(|it| it.chunk_start_offset);
    metadata_indexes.sort_unstable_by_key(|it| it.offset);
    let chunks = chunk_indexes.iter();
    let records = metadata_indexes.iter();
    !overlap(chunks.map(|it| (it.chunk_start_offset, it.chunk_length)))
        && !overlap(records.map(|it| (it.offset, it.length)))
}

/// Compares the checksum of the footer, which ends at `footer_end`, with the bytes from `from` up to it.
fn verify(file: &File, from: u64, footer: &Footer, footer_end: u64) -> McapResult<()> {
    let saved = footer.summary_crc;
    if saved == 0 {
        // The writer computed no checksum.
        return Ok(());
    }
    let crc_at = footer_end - size_of_val(&saved) as u64;
    let mut crc = Hasher::new();
    hash_part(file, from..crc_at, &mut crc)?;
    let calculated = crc.finalize();
    match saved == calculated {
        true => Ok(()),
        false => Err(McapError::BadSummaryCrc { saved, calculated }),
    }
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

#[cfg(test)]
mod tests {
    use mcap::records::{ChunkIndex, MetadataIndex};

    use super::*;

    fn summary(chunks: &[(u64, u64)], records: &[(u64, u64)]) -> Summary {
        let chunk = |&(chunk_start_offset, chunk_length): &_| ChunkIndex {
            message_start_time: 0,
            message_end_time: 0,
            chunk_start_offset,
            chunk_length,
            message_index_offsets: std::collections::BTreeMap::new(),
            message_index_length: 0,
            compression: String::new(),
            compressed_size: 0,
            uncompressed_size: 0,
        };
        let record = |&(offset, length): &_| MetadataIndex {
            offset,
            length,
            name: String::new(),
        };
        Summary {
            chunk_indexes: chunks.iter().map(chunk).collect(),
            metadata_indexes: records.iter().map(record).collect(),
            ..Summary::default()
        }
    }

    #[test]
    fn places_of_a_summary_do_not_overlap() {
        let (apart, together) = ([(30, 5), (10, 20)], [(29, 5), (10, 20)]);
        for (chunks, records, is_right) in [
            (apart, apart, true),
            (together, apart, false),
            (apart, together, false),
            (together, together, false),
        ] {
            let mut summary = summary(&chunks, &records);
            assert_eq!(
                sort_and_compare(&mut summary),
                is_right,
                "{chunks:?} {records:?}"
            );
            assert_eq!(summary.chunk_indexes[0].chunk_start_offset, 10);
            assert_eq!(summary.metadata_indexes[0].offset, 10);
        }
        assert!(sort_and_compare(&mut summary(&[(0, u64::MAX)], &[])));
    }
}
