//! The thread that writes the files.

use std::sync::Arc;
use std::time::Duration;

use sm2_proto::Instant;

use super::parts::Parts;
use crate::clock::{ClockRelation, MonotonicClock};
use crate::error::WriteError;
use crate::queue::{Awaited, Batch, HeldBy, Item, Payload, Queue};
use crate::report::Report;
use crate::writer::{Done, LongMessage};

/// Writes the items of the queue until it is closed.
pub(super) fn write(
    mut parts: Parts,
    queue: &Arc<Queue>,
    interval: Duration,
    (clock, monotonic_clock): (ClockRelation, MonotonicClock),
) -> Result<Report, WriteError> {
    let mut sync_at = sm2_io::clock::now().after(interval);
    let mut state = State::Synced;
    let mut batch = Batch::default();
    let mut is_full = false;
    loop {
        let now = sm2_io::clock::now();
        if now >= sync_at {
            match state {
                State::Synced => {}
                State::Syncing => {
                    parts.end_sync()?;
                    state = State::Synced;
                }
                State::Written => {
                    parts.begin_sync()?;
                    state = State::Syncing;
                }
            }
            // Nothing of an idle recording grows, but a full disk may have got room.
            if state == State::Syncing || is_full {
                let was_full = std::mem::replace(&mut is_full, parts.is_disk_full()?);
                queue.set_disk_full(is_full);
                // A synchronization that has just begun has the gaps.
                if was_full && !is_full && state == State::Synced {
                    state = State::Written;
                }
            }
            sync_at = sm2_io::clock::now().after(interval);
        }
        let (awaited, timeout) = match is_full {
            true => (Awaited::Urgent, sync_at.since(now)),
            false => next_event(sync_at, now, state),
        };
        let goes_on = queue.pop(&mut batch, awaited, timeout);
        // The gaps of a full disk are written together, when there is room again.
        let is_written = |it: &Item| !(is_full && matches!(it, Item::Gap(..)));
        if batch.items.iter().any(is_written) {
            state = State::Written;
        }
        let Batch { items, copies } = &mut batch;
        for item in items.drain(..) {
            write_item(&mut parts, queue, item, copies)?;
        }
        if !goes_on {
            return parts.finish(clock.wall_at(monotonic_clock()));
        }
    }
}

fn write_item(
    parts: &mut Parts,
    queue: &Arc<Queue>,
    item: Item,
    copies: &[u8],
) -> Result<(), WriteError> {
    match item {
        Item::Message {
            source,
            times,
            payload,
        } => match payload {
            Payload::Copied(place) => {
                let data = &copies[place];
                parts.message(&source, times, data)?;
                queue.mark_written(data.len(), None);
                Ok(())
            }
            Payload::Held(message, by) => {
                let done = mark_written(queue, message.len(), Some(by));
                parts.long_message(&source, times, LongMessage::Held(message), done)
            }
            Payload::Owned(data) => {
                let done = mark_written(queue, data.len(), None);
                parts.long_message(&source, times, LongMessage::Owned(data), done)
            }
        },
        Item::Gap(source, gap) => parts.gap(&source, gap),
        Item::Left(source) => {
            parts.left(&source);
            Ok(())
        }
        Item::Clock(clock) => parts.clock(clock),
        Item::Missing(missing) => parts.missing(missing),
        Item::NotRecorded(topics) => parts.not_recorded(topics),
        Item::EndFile(now_ns) => parts.end_file(now_ns),
    }
}

/// Counts a long message as written.
fn mark_written(queue: &Arc<Queue>, len: usize, held: Option<HeldBy>) -> Done {
    let queue = Arc::clone(queue);
    Box::new(move || queue.mark_written(len, held))
}

/// How much of the file is safe against a power cut.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum State {
    /// Everything.
    Synced,
    /// Everything will be, unless the disk fails.
    Syncing,
    /// Something was written since the last interval ended.
    Written,
}

/// The event that the writer waits for, and for how long. Without work it does not wake up.
fn next_event(sync_at: Instant, now: Instant, state: State) -> (Awaited, Duration) {
    match state {
        State::Synced => (Awaited::Item, Duration::from_secs(3_600)),
        State::Syncing | State::Written => (Awaited::Urgent, sync_at.since(now)),
    }
}
