//! Checking a bag for damage.

use std::collections::HashMap;
use std::fmt;
use std::path::Path;

use mcap::Summary;
use mcap::records::ChunkIndex;
use serde::Serialize;

use crate::bag::{Bag, open_file, scan_file};
use crate::bag_files::BagFiles;
use crate::copy::add_damaged;
use crate::damaged::DamagedPart;
use crate::error::ReadError;
use crate::messages::Filter;
use crate::observer::{Observer, unobserved};
use crate::report::Report;
use crate::scan::Scan;
use crate::summary;

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
    /// A part of the file cannot be read.
    Unreadable(DamagedPart),
    /// The checksum over all records is wrong: a byte outside of the chunks has changed, or a chunk without a checksum.
    Records {
        /// The fault.
        reason: String,
    },
    /// The head of a chunk names other times than its messages have. They are read by their own times.
    Times {
        /// The place of the first such chunk, in bytes.
        offset: u64,
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
            Self::Unreadable(part) => write!(f, "unreadable: {part}"),
            Self::Records { reason } => write!(f, "a record has changed: {reason}"),
            Self::Times { offset } => write!(
                f,
                "the chunk at byte {offset} names other times than its messages have"
            ),
            Self::Summary { reason } => write!(f, "the summary is wrong: {reason}"),
        }
    }
}

/// Reads a bag completely and once, verifies all checksums, and compares the summary with the records. Payloads that
/// are compressed on their own are read once more, to decompress them.
///
/// # Errors
///
/// [`ReadError`], if the file cannot be read or is not an MCAP file.
pub fn check(path: &Path) -> Result<Verdict, ReadError> {
    check_file(path, false, &mut unobserved)
}

impl BagFiles {
    /// Does what [`check`](fn@check) does for each file.
    ///
    /// # Errors
    ///
    /// [`ReadError`], if a file cannot be read or is not an MCAP file.
    pub fn check(&self, observer: &mut Observer<'_>) -> Result<Vec<Verdict>, ReadError> {
        let paths = self.paths().iter();
        let verdicts = paths.map(|it| check_file(it, self.has_packed_payloads(), observer));
        verdicts.collect()
    }
}

/// `has_packed_payloads` says that each payload of the file is compressed, although the file may not say it.
fn check_file(
    path: &Path,
    has_packed_payloads: bool,
    observer: &mut Observer<'_>,
) -> Result<Verdict, ReadError> {
    let (file, end) = open_file(path, observer)?;
    let scan = scan_file(path, &file, end, observer)?;
    let unreadable = scan.damaged.iter().chain(&scan.torn).cloned();
    let unreadable: Vec<_> = unreadable.map(Damage::Unreadable).collect();
    let records = (scan.wrong_crc.as_ref()).map(|error| Damage::Records {
        reason: error.to_string(),
    });
    let wrong_times = scan.wrong_times;
    let mut damages = Vec::new();
    let bag = match Bag::of_summary(path, &file, end)? {
        Some(bag) => {
            // An unreadable part explains why the summary says something else.
            damages.extend(match unreadable.is_empty() {
                true => summary_damage(&bag, &scan),
                false => None,
            });
            let damaged = scan.damaged().cloned().collect();
            bag.with_damaged(damaged)
        }
        None => {
            let summary = summary::read(&file, end);
            let total = total(&scan);
            let bag = Bag::of_scan(path, file, end, scan);
            let reason = match summary {
                _ if !bag.is_complete() => {
                    damages.push(Damage::Incomplete);
                    None
                }
                Err(error) => Some(error.to_string()),
                Ok(summary) => {
                    let said = summary.and_then(|it| it.stats).map(|it| it.message_count);
                    let said = said.filter(|it| *it != total && unreadable.is_empty());
                    said.map(|said| format!("it says {said} messages, and there are {total}"))
                }
            };
            damages.extend(reason.map(|reason| Damage::Summary { reason }));
            bag
        }
    };
    damages.extend(unreadable);
    let bag = match has_packed_payloads {
        true => bag.with_packed_payloads(),
        false => bag,
    };
    damages.extend(wrong_payloads(&bag)?);
    damages.extend(records);
    damages.extend(wrong_times.map(|offset| Damage::Times { offset }));
    let report = bag.report();
    Ok(Verdict { damages, report })
}

/// The payloads that are compressed on their own and cannot be decompressed. A part is named once.
fn wrong_payloads(bag: &Bag) -> Result<Vec<Damage>, ReadError> {
    let mut parts = Vec::new();
    if !bag.has_packed_payloads() {
        return Ok(Vec::new());
    }
    for message in bag.messages(&Filter::default()) {
        match message {
            Ok(_) => {}
            Err(ReadError::Damaged { part, .. }) => add_damaged(&mut parts, part),
            Err(error) => return Err(error),
        }
    }
    parts.retain(|it| !bag.damaged().contains(it));
    Ok(parts.into_iter().map(Damage::Unreadable).collect())
}

/// The number of messages that were read.
fn total(scan: &Scan) -> u64 {
    scan.counts.values().map(|it| it.messages).sum()
}

/// Whether `all` has each entry of `some`.
fn contains<T: PartialEq>(all: &HashMap<u16, T>, some: &HashMap<u16, T>) -> bool {
    some.iter().all(|(id, it)| all.get(id) == Some(it))
}

/// Compares the summary of a bag with its records. Messages in chunks are found by the channels and by the places and
/// times of the chunks, so nothing else of the summary can hide one.
fn summary_damage(bag: &Bag, scan: &Scan) -> Option<Damage> {
    let (says, has) = (bag.summary(), &scan.summary);
    let places = |summary: &Summary| -> Vec<_> {
        let chunks = summary.chunk_indexes.iter();
        let place = |it: &ChunkIndex| {
            let times = (it.message_start_time, it.message_end_time);
            (it.chunk_start_offset, it.chunk_length, times)
        };
        chunks.map(place).collect()
    };
    let total = total(scan);
    let report = bag.report();
    let said = report.topics.iter();
    let said = said.map(|it| it.messages.saturating_add(it.repeated));
    let said = said.fold(0, u64::saturating_add);
    // A channel or a type that only the summary names has no messages: messages follow the record of their channel.
    let has_all = contains(&says.channels, &has.channels) && contains(&says.schemas, &has.schemas);
    let reason = if !has_all {
        "it describes other channels or types".to_owned()
    } else if places(says) != places(has) {
        "it names other places or times of the chunks".to_owned()
    } else if said != total {
        format!("it says {said} messages, and there are {total}")
    } else if !scan.runs.is_empty() {
        "there are messages outside of chunks, which it cannot name".to_owned()
    } else {
        return None;
    };
    Some(Damage::Summary { reason })
}
