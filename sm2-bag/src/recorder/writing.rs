//! The thread that writes the files.

use std::time::Duration;

use sm2_proto::Instant;

use super::parts::Parts;
use crate::clock::ClockRelation;
use crate::error::WriteError;
use crate::queue::{Item, Payload, Queue};
use crate::report::Report;

/// Writes the items of the queue until it is closed.
pub(super) fn write(
    mut parts: Parts,
    queue: &Queue,
    interval: Duration,
    clock: ClockRelation,
) -> Result<Report, WriteError> {
    let mut sync_at = sm2_io::clock::now().after(interval);
    let mut is_clean = true;
    loop {
        let now = sm2_io::clock::now();
        if now >= sync_at {
            if !is_clean {
                parts.sync()?;
                is_clean = true;
                if parts.is_disk_full()? {
                    queue.note_disk_full();
                }
            }
            sync_at = sm2_io::clock::now().after(interval);
        }
        let (item, goes_on) = queue.pop(time_until(sync_at, now, is_clean));
        is_clean &= item.is_none();
        match item {
            Some(Item::Message {
                source,
                times,
                payload,
            }) => {
                parts.message(&source, times, payload.bytes())?;
                let len = payload.bytes().len();
                let held = match &payload {
                    Payload::Held(_, by) => Some(*by),
                    Payload::Copied(_) => None,
                };
                drop(payload);
                queue.note_written(len, held);
            }
            Some(Item::Gap(source, gap)) => parts.gap(&source, gap)?,
            Some(Item::Clock(clock)) => parts.clock(clock)?,
            Some(Item::EndFile(now_ns)) => parts.end_file(now_ns)?,
            None => {}
        }
        if !goes_on {
            return parts.finish(clock.wall_at(sm2_io::clock::now()));
        }
    }
}

/// How long the writer may wait for an item. Without work it does not wake up.
fn time_until(sync_at: Instant, now: Instant, is_clean: bool) -> Duration {
    match is_clean {
        true => Duration::from_secs(3_600),
        false => sync_at.since(now),
    }
}
