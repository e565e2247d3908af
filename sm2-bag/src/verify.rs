//! Checking a bag for damage.

use std::fmt;
use std::path::Path;

use mcap::Summary;
use mcap::records::ChunkIndex;
use serde::Serialize;

use crate::bag::{Bag, open_file};
use crate::error::ReadError;
use crate::messages::Filter;
use crate::report::Report;
use crate::scan::Scan;

/// The result of a check.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct Verdict {
    /// The damages; empty for a bag that is whole.
    pub damages: Vec<Damage>,
    /// The summary of the readable part.
    pub report: Report,
}

/// Something that is wrong with a bag.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Damage {
    /// The recording did not end in order, so the bag has no summary.
    Incomplete,
    /// The records cannot be read from this place on.
    Unreadable {
        /// The place, in bytes.
        offset: u64,
        /// The fault.
        reason: String,
    },
    /// The summary says something else than the records.
    Summary {
        /// The difference.
        reason: String,
    },
}

impl fmt::Display for Damage {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Incomplete => {
                f.write_str("the recording did not end in order: there is no summary")
            }
            Self::Unreadable { offset, reason } => {
                write!(f, "unreadable from byte {offset} on: {reason}")
            }
            Self::Summary { reason } => write!(f, "the summary is wrong: {reason}"),
        }
    }
}

/// Reads a bag completely, verifies all checksums, and compares the summary with the records.
///
/// # Errors
///
/// [`ReadError`], if the file cannot be read or is no MCAP file.
pub fn check(path: &Path) -> Result<Verdict, ReadError> {
    let bag = Bag::open(path)?;
    let (file, end) = open_file(path)?;
    let scan = Scan::of(&file, end);
    let mut damages = Vec::new();
    if !bag.is_complete() {
        damages.push(Damage::Incomplete);
    }
    if let Some((offset, error)) = &scan.damage {
        damages.push(Damage::Unreadable {
            offset: *offset,
            reason: error.to_string(),
        });
    }
    let report = bag.report();
    if bag.is_complete() && scan.damage.is_none() {
        damages.extend(summary_damage(&bag, &scan)?);
    }
    Ok(Verdict { damages, report })
}

/// Compares the summary of a bag with its records.
fn summary_damage(bag: &Bag, scan: &Scan) -> Result<Option<Damage>, ReadError> {
    let (says, has) = (bag.summary(), &scan.summary);
    let places = |summary: &Summary| -> Vec<_> {
        let chunks = summary.chunk_indexes.iter();
        let place = |it: &ChunkIndex| {
            let times = (it.message_start_time, it.message_end_time);
            (it.chunk_start_offset, it.chunk_length, times)
        };
        chunks.map(place).collect()
    };
    let total: u64 = scan.counts.values().map(|it| it.messages).sum();
    let said: u64 = bag.report().topics.iter().map(|it| it.messages).sum();
    let mut indexed = 0;
    for message in bag.messages(&Filter::default())? {
        message?;
        indexed += 1;
    }
    let reason = if says.channels != has.channels || says.schemas != has.schemas {
        "it describes other channels or types".to_owned()
    } else if places(says) != places(has) {
        "it names other places or times of the chunks".to_owned()
    } else if said != total {
        format!("it says {said} messages, and there are {total}")
    } else if indexed != total {
        format!("{indexed} messages can be found by it, and there are {total}")
    } else {
        return Ok(None);
    };
    Ok(Some(Damage::Summary { reason }))
}
