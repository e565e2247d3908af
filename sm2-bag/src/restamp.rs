//! Giving a recording the times of a clock that was corrected while it ran.
//!
//! All times of a recording follow the wall clock as it was at the start: they do not step. Each step of the wall clock
//! is a further relation to the monotonic clock, and the last one is taken as right: a computer without a battery for
//! its clock starts in 1970, and gets the time from the network later. So all times move by the same span.

use std::collections::BTreeMap;
use std::path::Path;

use mcap::records::Metadata;
use serde::Serialize;

use crate::bag::Bag;
use crate::clock::ClockRelation;
use crate::copy::{CopyOptions, copy_with};
use crate::error::RestampError;
use crate::messages::Filter;
use crate::observer::Observer;
use crate::report::Report;
use crate::shift::Shift;
use crate::writer::Compression;
use crate::written_by::WrittenBy;

/// The name of the metadata record of a bag whose times were moved.
const RECORD: &str = "sm2.restamped";

/// The change of a recording whose times were corrected.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct Restamped {
    /// How far all times have moved, in nanoseconds; below 0 towards the past.
    pub shift_ns: i128,
    /// The number of times that the wall clock stepped during the recording.
    pub steps: usize,
    /// When the last step was noticed, in nanoseconds of the corrected clock.
    pub corrected_at_ns: u64,
    /// The summary of the new bag.
    pub report: Report,
}

/// Writes the files of one recording to the new bag `to`, with the times that the wall clock would have shown if it had
/// always been as it was after its last step: of messages, gaps, missing topics, incidents and of the recorder. The new
/// bag has one relation of the clocks, and a metadata record with the span. The observer is told about the payloads.
///
/// # Errors
///
/// [`RestampError`]; no new bag remains then.
pub fn restamp(
    bags: &[Bag],
    to: &Path,
    compression: Compression,
    observer: &mut Observer<'_>,
) -> Result<Restamped, RestampError> {
    let relations = relations(bags)?;
    let (Some(start), Some(last)) = (relations.first(), relations.last()) else {
        return Err(RestampError::NoRelation);
    };
    let shift_ns = i128::from(last.wall_ns) - i128::from(start.wall_at(last.monotonic));
    let steps = relations.len() - 1;
    if steps == 0 || shift_ns == 0 {
        return Err(RestampError::NoStep);
    }
    let shift = Shift(shift_ns);
    let clock = ClockRelation {
        wall_ns: shift.apply(start.wall_ns),
        ..*start
    };
    let span = BTreeMap::from([("shift_ns".to_owned(), shift_ns.to_string())]);
    let records = [(ClockRelation::RECORD, clock.metadata()), (RECORD, span)];
    let metadata = records.map(|(name, metadata)| Metadata {
        name: name.to_owned(),
        metadata,
    });
    let options = CopyOptions {
        filter: &Filter::default(),
        compression,
        metadata: &metadata,
        shift,
    };
    let report = copy_with(bags, to, &options, observer)?;
    Ok(Restamped {
        shift_ns,
        steps,
        corrected_at_ns: last.wall_ns,
        report,
    })
}

/// The relations of the clocks during a recording, in their order.
fn relations(bags: &[Bag]) -> Result<Vec<ClockRelation>, RestampError> {
    let mut start = None;
    let mut relations = Vec::new();
    for bag in bags {
        let mut records = bag.metadata().iter().peekable();
        while let Some(record) = records.next() {
            let relation = (record.name == ClockRelation::RECORD)
                .then(|| ClockRelation::from_metadata(&record.metadata));
            let Some(relation) = relation.flatten() else {
                continue;
            };
            // Each file begins with the relation at the start of its recording, and names its recorder next.
            let is_start = records
                .peek()
                .is_some_and(|it| it.name == WrittenBy::RECORD);
            if is_start && *start.get_or_insert(relation) != relation {
                return Err(RestampError::SeveralRecordings);
            }
            if !relations.contains(&relation) {
                relations.push(relation);
            }
        }
    }
    if start.is_none() {
        // Recorders of earlier versions do not name themselves.
        start = relations.first().copied();
    }
    relations.sort_unstable_by_key(|it| it.monotonic);
    match relations.first().copied() == start {
        true => Ok(relations),
        // The monotonic clock began again.
        false => Err(RestampError::SeveralRecordings),
    }
}
