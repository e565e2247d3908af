//! Writing a bag.

use std::collections::{BTreeMap, HashMap};
use std::io::{BufWriter, Seek, Write};
use std::sync::Arc;

use mcap::records::{MessageHeader, Metadata};
use mcap::{McapResult, WriteOptions, Writer};

use crate::clock::ClockRelation;
use crate::error::WriteError;
use crate::gap::{Gap, GapReason};
use crate::report::{Counts, Report, ReportBuilder, widen};
use crate::source::Source;
use crate::storage::{SharedStorage, Storage};

/// How much is written with one system call, in bytes.
const BUFFER_BYTES: usize = 1 << 20;

/// How the chunks of a bag are compressed.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Compression {
    /// Not at all.
    #[default]
    None,
    /// LZ4: fast.
    Lz4,
    /// Zstandard: small.
    Zstd,
}

/// The options of the MCAP writer for all bags.
pub(crate) fn write_options(compression: Compression) -> WriteOptions {
    WriteOptions::new()
        .profile("sm2")
        .library(concat!("sm2-bag/", env!("CARGO_PKG_VERSION")))
        .compression(compression.into())
        // The chunks have checksums.
        .calculate_data_section_crc(false)
}

/// Writes the counts of all channels, which a complete bag has.
pub(crate) fn write_counts<W: Write + Seek>(
    writer: &mut Writer<W>,
    counts: &BTreeMap<u16, Counts>,
) -> McapResult<()> {
    for (channel, counts) in counts {
        writer.write_metadata(&Metadata {
            name: Counts::RECORD.to_owned(),
            metadata: counts.metadata(*channel),
        })?;
    }
    Ok(())
}

/// A message to write.
#[derive(Clone, Copy, Debug)]
pub(crate) struct MessageTimes {
    pub(crate) sequence: u32,
    pub(crate) log_time: u64,
    pub(crate) publish_time: u64,
}

/// Writes a bag.
pub(crate) struct BagWriter {
    mcap: Writer<BufWriter<SharedStorage>>,
    storage: SharedStorage,
    channels: HashMap<Arc<Source>, u16>,
    counts: BTreeMap<u16, Counts>,
    times: Option<(u64, u64)>,
    /// The gaps since the last interval, which are written at its end.
    open_gaps: BTreeMap<(Arc<str>, String, GapReason), Gap>,
    /// All gaps, with their topics.
    gaps: Vec<(Arc<str>, Gap)>,
}

impl BagWriter {
    pub(crate) fn new(
        storage: impl Storage + 'static,
        compression: Compression,
        clock: ClockRelation,
    ) -> Result<Self, WriteError> {
        let storage = SharedStorage::new(storage);
        let file = BufWriter::with_capacity(BUFFER_BYTES, storage.clone());
        let mcap = write_options(compression).create(file)?;
        let mut writer = Self {
            mcap,
            storage,
            channels: HashMap::new(),
            counts: BTreeMap::new(),
            times: None,
            open_gaps: BTreeMap::new(),
            gaps: Vec::new(),
        };
        writer.clock(clock)?;
        Ok(writer)
    }

    /// Writes a relation of the clocks.
    pub(crate) fn clock(&mut self, clock: ClockRelation) -> Result<(), WriteError> {
        self.metadata(ClockRelation::RECORD, clock.metadata())
    }

    pub(crate) fn message(
        &mut self,
        source: &Arc<Source>,
        times: MessageTimes,
        data: &[u8],
    ) -> Result<(), WriteError> {
        let channel_id = self.channel(source)?;
        let MessageTimes {
            sequence,
            log_time,
            publish_time,
        } = times;
        let header = MessageHeader {
            channel_id,
            sequence,
            log_time,
            publish_time,
        };
        self.mcap.write_to_known_channel(&header, data)?;
        self.counts.entry(channel_id).or_default().add(data.len());
        widen(&mut self.times, log_time);
        Ok(())
    }

    /// The channel of a publisher.
    fn channel(&mut self, source: &Arc<Source>) -> Result<u16, WriteError> {
        if let Some(id) = self.channels.get(source) {
            return Ok(*id);
        }
        let (encoding, text) = source.schema_record();
        let schema = self
            .mcap
            .add_schema(source.data.name.as_str(), encoding, text)?;
        let id = self.mcap.add_channel(
            schema,
            source.topic.as_str(),
            &source.message_encoding(),
            &source.metadata(),
        )?;
        self.channels.insert(Arc::clone(source), id);
        Ok(id)
    }

    /// Notes messages that are missing.
    pub(crate) fn gap(&mut self, source: &Arc<Source>, gap: Gap) -> Result<(), WriteError> {
        // A topic whose only messages are missing has a channel, too.
        self.channel(source)?;
        let topic: Arc<str> = source.topic.as_str().into();
        let key = (Arc::clone(&topic), gap.publisher.clone(), gap.reason);
        match self.open_gaps.get_mut(&key) {
            Some(before) => {
                if !before.extend(&gap) {
                    let ended = std::mem::replace(before, gap);
                    self.write_gap(topic, ended)?;
                }
            }
            None => {
                self.open_gaps.insert(key, gap);
            }
        }
        Ok(())
    }

    fn write_gap(&mut self, topic: Arc<str>, gap: Gap) -> Result<(), WriteError> {
        self.metadata(Gap::RECORD, gap.metadata(&topic))?;
        self.gaps.push((topic, gap));
        Ok(())
    }

    fn metadata(
        &mut self,
        name: &str,
        metadata: BTreeMap<String, String>,
    ) -> Result<(), WriteError> {
        let name = name.to_owned();
        Ok(self.mcap.write_metadata(&Metadata { name, metadata })?)
    }

    /// Ends an interval: what was written before can be read after a power cut.
    pub(crate) fn sync(&mut self) -> Result<(), WriteError> {
        for ((topic, ..), gap) in std::mem::take(&mut self.open_gaps) {
            self.write_gap(topic, gap)?;
        }
        self.mcap.flush()?;
        Ok(self.storage.sync()?)
    }

    /// Writes the summary, and ends the bag.
    pub(crate) fn finish(mut self) -> Result<Report, WriteError> {
        self.sync()?;
        write_counts(&mut self.mcap, &self.counts)?;
        self.mcap.finish()?;
        self.storage.sync()?;
        let mut report = ReportBuilder::default();
        for (source, id) in &self.channels {
            let counts = self.counts.get(id).copied().unwrap_or_default();
            report.add_channel(source.topic.as_str(), source.data.name.as_str(), counts);
        }
        for (topic, gap) in &self.gaps {
            report.add_gap(topic, gap);
        }
        Ok(report.finish(self.times, true))
    }
}

impl Drop for BagWriter {
    /// The MCAP writer writes a summary when it is dropped. After an error, the bag would look complete.
    fn drop(&mut self) {
        self.storage.close();
    }
}

impl From<Compression> for Option<mcap::Compression> {
    fn from(compression: Compression) -> Self {
        match compression {
            Compression::None => None,
            Compression::Lz4 => Some(mcap::Compression::Lz4),
            Compression::Zstd => Some(mcap::Compression::Zstd),
        }
    }
}
