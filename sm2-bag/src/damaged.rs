//! The parts of a bag that are damaged.

use std::collections::BTreeMap;
use std::fmt;
use std::io::{Seek, Write};

use mcap::records::Metadata;
use mcap::{McapError, McapResult, Writer};
use serde::Serialize;

use crate::gap::Gap;

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
    /// Whether this place of the file is in it.
    pub(crate) const fn has(&self, offset: u64) -> bool {
        self.offset <= offset && offset - self.offset < self.bytes
    }

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
