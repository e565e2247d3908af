//! Reading a bag.

use std::collections::BTreeMap;
use std::fs::File;
use std::io::{self, Read, Seek, SeekFrom};
use std::os::unix::fs::FileExt;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use mcap::records::{Metadata, MetadataIndex};
use mcap::sans_io::summary_reader::{SummaryReadEvent, SummaryReader, SummaryReaderOptions};
use mcap::{Channel, MAGIC, McapError, McapResult, Summary};

use crate::chunk::{Entry, RecordReader};
use crate::clock::ClockRelation;
use crate::error::ReadError;
use crate::gap::Gap;
use crate::messages::{Filter, Messages};
use crate::report::{Counts, Report, ReportBuilder};
use crate::scan::Scan;
use crate::source::Source;

/// A bag, open for reading. Its messages stay on the disk until they are read.
#[derive(Debug)]
pub struct Bag {
    path: PathBuf,
    file: File,
    summary: Summary,
    counts: BTreeMap<u16, Counts>,
    times: Option<(u64, u64)>,
    gaps: Vec<(String, Gap)>,
    clocks: Vec<ClockRelation>,
    metadata: Vec<Metadata>,
    is_unchunked: bool,
    complete: bool,
}

impl Bag {
    /// Opens a bag. Reads its summary, or else all of its chunks up to the first damage.
    ///
    /// # Errors
    ///
    /// [`ReadError`], if the file cannot be read or is no MCAP file.
    pub fn open(path: &Path) -> Result<Self, ReadError> {
        let (mut file, end) = open_file(path)?;
        match summary(&mut file, end) {
            Ok(Some(summary)) => {
                if let Some(bag) = Self::of_summary(path, &file, summary, end)? {
                    return Ok(bag);
                }
            }
            Err(error @ McapError::Io(_)) => return Err(ReadError::of(path, error)),
            // The file has no summary, or its summary is damaged.
            Ok(None) | Err(_) => {}
        }
        let scan = Scan::of(&file, end);
        let complete = scan.damage.is_none() && end_is_magic(&file, end);
        Ok(Self::new(path, file, scan, complete))
    }

    /// The bag with this summary. `None` if it lacks the counts of a channel, because another program wrote it.
    fn of_summary(
        path: &Path,
        file: &File,
        summary: Summary,
        end: u64,
    ) -> Result<Option<Self>, ReadError> {
        let mut metadata = Vec::new();
        for index in &summary.metadata_indexes {
            // A place that holds something else makes the summary worthless.
            let Ok(Some(record)) = read_metadata(file, index, end) else {
                return Ok(None);
            };
            metadata.push(record);
        }
        let named = metadata.iter().filter(|it| it.name == Counts::RECORD);
        let counts: BTreeMap<_, _> = named
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
        if !stats.channel_message_counts.iter().all(is_counted) {
            return Ok(None);
        }
        let times = (stats.message_start_time, stats.message_end_time);
        let times = (stats.message_count > 0).then_some(times);
        let file = file.try_clone().map_err(|source| ReadError::Io {
            path: path.to_owned(),
            source,
        })?;
        let scan = Scan {
            summary,
            counts,
            times,
            metadata,
            // The counts are those of this crate, which writes chunks.
            is_unchunked: false,
            damage: None,
        };
        Ok(Some(Self::new(path, file, scan, true)))
    }

    fn new(path: &Path, file: File, scan: Scan, complete: bool) -> Self {
        let named = |name| {
            let records = scan.metadata.iter().filter(move |it| it.name == name);
            records.map(|it| &it.metadata)
        };
        Self {
            path: path.to_owned(),
            file,
            gaps: named(Gap::RECORD).filter_map(Gap::from_metadata).collect(),
            clocks: named(ClockRelation::RECORD)
                .filter_map(ClockRelation::from_metadata)
                .collect(),
            metadata: scan.metadata,
            is_unchunked: scan.is_unchunked,
            summary: scan.summary,
            counts: scan.counts,
            times: scan.times,
            complete,
        }
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
            let data = channel.schema.as_ref().map_or("", |it| it.name.as_str());
            let counts = self.counts.get(id).copied().unwrap_or_default();
            report.add_channel(&channel.topic, data, counts);
        }
        for (topic, gap) in &self.gaps {
            report.add_gap(topic, gap);
        }
        report.finish(self.times, self.complete)
    }

    /// Whether the recording ended in order.
    #[must_use]
    pub const fn is_complete(&self) -> bool {
        self.complete
    }

    /// The publishers that were recorded. A channel of another program has none.
    pub fn sources(&self) -> impl Iterator<Item = (Arc<Channel<'static>>, Option<Source>)> {
        let channels = self.summary.channels.values();
        channels.map(|it| (Arc::clone(it), Source::of_channel(it)))
    }

    /// The relations of the wall clock to the monotonic clock: at the start, and after each step of the wall clock.
    #[must_use]
    pub fn clocks(&self) -> &[ClockRelation] {
        &self.clocks
    }

    /// The messages in the order of their `log_time`.
    ///
    /// # Errors
    ///
    /// [`ReadError::Unchunked`], if another program wrote messages that are in no chunk.
    pub fn messages(&self, filter: &Filter) -> Result<Messages<'_>, ReadError> {
        if self.is_unchunked {
            let path = self.path.clone();
            return Err(ReadError::Unchunked { path });
        }
        Ok(Messages::new(&self.file, &self.path, &self.summary, filter))
    }

    /// The metadata records, in their order.
    pub(crate) fn metadata(&self) -> &[Metadata] {
        &self.metadata
    }

    pub(crate) const fn summary(&self) -> &Summary {
        &self.summary
    }
}

/// Opens a file that begins like an MCAP file. Returns it with its length in bytes.
pub(crate) fn open_file(path: &Path) -> Result<(File, u64), ReadError> {
    let failed = |source| ReadError::Io {
        path: path.to_owned(),
        source,
    };
    let file = File::open(path).map_err(failed)?;
    let end = file.metadata().map_err(failed)?.len();
    let mut magic = [0; MAGIC.len()];
    if end < MAGIC.len() as u64 || file.read_exact_at(&mut magic, 0).is_err() || magic != MAGIC {
        return Err(ReadError::NotABag { path: path.into() });
    }
    Ok((file, end))
}

/// Reads the summary of a file; `None` if it has none.
fn summary(file: &mut File, end: u64) -> McapResult<Option<Summary>> {
    let limit = usize::try_from(end).unwrap_or(usize::MAX);
    let options = SummaryReaderOptions::default()
        .with_file_size(end)
        .with_record_length_limit(limit);
    let mut reader = SummaryReader::new_with_options(options);
    while let Some(event) = reader.next_event() {
        match event? {
            SummaryReadEvent::ReadRequest(want) => {
                let read = file.read(reader.insert(want.min(limit)))?;
                reader.notify_read(read);
            }
            SummaryReadEvent::SeekRequest(SeekFrom::Start(to)) if to > end => {
                return Err(McapError::UnexpectedEof);
            }
            SummaryReadEvent::SeekRequest(to) => match file.seek(to) {
                Ok(at) => reader.notify_seeked(at),
                // A file that is shorter than a footer.
                Err(error) if error.kind() == io::ErrorKind::InvalidInput => {
                    return Err(McapError::UnexpectedEof);
                }
                Err(error) => return Err(error.into()),
            },
        }
    }
    Ok(reader.finish())
}

fn read_metadata(file: &File, index: &MetadataIndex, end: u64) -> McapResult<Option<Metadata>> {
    let Some(record) = RecordReader::new(file, index.offset, end).next()? else {
        return Ok(None);
    };
    let mut found = None;
    record.entries(|entry| {
        if let Entry::Metadata(metadata) = entry {
            found = Some(metadata);
        }
        Ok(())
    })?;
    Ok(found)
}

fn end_is_magic(file: &File, end: u64) -> bool {
    let mut magic = [0; MAGIC.len()];
    let at = end.saturating_sub(MAGIC.len() as u64);
    file.read_exact_at(&mut magic, at).is_ok() && magic == MAGIC
}
