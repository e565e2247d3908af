//! The parts of a bag that are damaged.

use std::collections::BTreeMap;
use std::fmt;
use std::io::{Seek, Write};

use mcap::records::Metadata;
use mcap::{McapError, McapResult, Writer};
use serde::Serialize;

use crate::bag::Bag;
use crate::gap::{Gap, GapReason};
use crate::source::Source;

/// A part of a bag that is damaged. The messages that it had are missing.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct DamagedPart {
    /// Its place in the file where it was found, in bytes. A copy of the bag names the place in the original file.
    pub offset: u64,
    /// Its length, in bytes.
    pub bytes: u64,
    /// The fault.
    pub reason: String,
}

impl fmt::Display for DamagedPart {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self {
            offset,
            bytes,
            reason,
        } = self;
        write!(f, "{bytes} bytes from byte {offset} on: {reason}")
    }
}

impl DamagedPart {
    /// The name of its metadata record.
    pub(crate) const RECORD: &str = "sm2.damaged";

    pub(crate) fn new((offset, bytes): (u64, u64), reason: &McapError) -> Self {
        Self {
            offset,
            bytes,
            reason: reason.to_string(),
        }
    }

    pub(crate) fn metadata(&self) -> BTreeMap<String, String> {
        [
            ("offset", self.offset.to_string()),
            ("bytes", self.bytes.to_string()),
            ("reason", self.reason.clone()),
        ]
        .map(|(key, value)| (key.to_owned(), value))
        .into()
    }

    pub(crate) fn from_metadata(metadata: &BTreeMap<String, String>) -> Option<Self> {
        Some(Self {
            offset: metadata.get("offset")?.parse().ok()?,
            bytes: metadata.get("bytes")?.parse().ok()?,
            reason: metadata.get("reason")?.clone(),
        })
    }
}

/// The gaps that damaged parts of a bag with a summary leave: one for each channel of which fewer messages could be
/// `read` than the summary counts. Their times are those of the damaged chunks.
pub(crate) fn gaps(
    bag: &Bag,
    parts: &[DamagedPart],
    read: impl Fn(u16) -> u64,
) -> Vec<(String, Gap)> {
    let is_damaged = |offset: u64| {
        let mut parts = parts.iter();
        parts.any(|it| (it.offset..it.offset.saturating_add(it.bytes)).contains(&offset))
    };
    let chunks = bag.summary().chunk_indexes.iter();
    let chunks = chunks.filter(|it| is_damaged(it.chunk_start_offset));
    let times = chunks.map(|it| (it.message_start_time, it.message_end_time));
    let Some((from_ns, to_ns)) = times.reduce(|a, b| (a.0.min(b.0), a.1.max(b.1))) else {
        return Vec::new();
    };
    let gap = |channel: &mcap::Channel<'_>| {
        let messages = bag.count(channel.id).checked_sub(read(channel.id))?;
        let publisher = Source::of_channel(channel).map(|it| it.publisher.to_string());
        let gap = Gap {
            publisher: publisher.unwrap_or_default(),
            from_ns,
            to_ns,
            messages,
            reason: GapReason::Damaged,
        };
        (messages > 0).then(|| (channel.topic.clone(), gap))
    };
    let mut gaps: Vec<_> = bag.channels().filter_map(|it| gap(it)).collect();
    gaps.sort_by(|one, other| one.0.cmp(&other.0));
    gaps
}

/// Writes the records of damaged parts, and of the gaps that they leave.
pub(crate) fn write<W: Write + Seek>(
    writer: &mut Writer<W>,
    parts: &[DamagedPart],
    gaps: &[(String, Gap)],
) -> McapResult<()> {
    let parts = parts.iter().map(|it| (DamagedPart::RECORD, it.metadata()));
    let gaps = gaps.iter();
    let gaps = gaps.map(|(topic, gap)| (Gap::RECORD, gap.metadata(topic)));
    for (name, metadata) in parts.chain(gaps) {
        let name = name.to_owned();
        writer.write_metadata(&Metadata { name, metadata })?;
    }
    Ok(())
}
