//! The places of records that the summary of a bag names. They show damage where a record has no checksum, and where
//! the bag goes on behind a damaged part.

use mcap::Summary;
use mcap::records::op;

use crate::chunk::RawRecord;
use crate::content::Entry;

/// A record that the summary names.
#[derive(Clone, Debug)]
pub(crate) struct Landmark {
    /// Its place in the file, in bytes.
    pub(crate) offset: u64,
    pub(crate) len_bytes: u64,
    opcode: u8,
    /// The name of a record of metadata.
    name: Option<String>,
}

impl Landmark {
    /// Whether this is the record, as far as it can be checked. A summary without a checksum can be wrong.
    pub(crate) fn is(&self, record: &RawRecord) -> bool {
        let is_like = (self.offset, self.len_bytes, self.opcode)
            == (record.offset, record.len_bytes(), record.opcode);
        is_like && record.verify().is_ok() && self.has_name(record)
    }

    fn has_name(&self, record: &RawRecord) -> bool {
        let Some(name) = &self.name else {
            return true;
        };
        let mut has_name = false;
        let visited = record.visit(&mut |entry: Entry<'_>| {
            has_name |= matches!(entry, Entry::Metadata(it) if it.name == *name);
            Ok(())
        });
        visited.is_ok() && has_name
    }
}

/// The records that the summary names, sorted by their places.
#[derive(Debug, Default)]
pub(crate) struct Landmarks(Vec<Landmark>);

impl Landmarks {
    pub(crate) fn of(summary: &Summary) -> Self {
        let landmark = |opcode, offset, len_bytes, name: Option<&String>| Landmark {
            offset,
            len_bytes,
            opcode,
            name: name.cloned(),
        };
        let chunks = summary.chunk_indexes.iter();
        let chunks =
            chunks.map(|it| landmark(op::CHUNK, it.chunk_start_offset, it.chunk_length, None));
        let metadata = summary.metadata_indexes.iter();
        let metadata =
            metadata.map(|it| landmark(op::METADATA, it.offset, it.length, Some(&it.name)));
        let attachments = summary.attachment_indexes.iter();
        let attachments =
            attachments.map(|it| landmark(op::ATTACHMENT, it.offset, it.length, None));
        let mut all: Vec<_> = chunks.chain(metadata).chain(attachments).collect();
        all.sort_by_key(|it| it.offset);
        Self(all)
    }

    /// The record at this place.
    pub(crate) fn at(&self, offset: u64) -> Option<&Landmark> {
        self.behind(offset.checked_sub(1)?)
            .next()
            .filter(|it| it.offset == offset)
    }

    /// The records that begin behind this place.
    pub(crate) fn behind(&self, offset: u64) -> impl Iterator<Item = &Landmark> {
        let from = self.0.partition_point(|it| it.offset <= offset);
        self.0[from..].iter()
    }
}
