//! Warnings of SM2 for Python's `logging`.
//!
//! `tracing` events may come while a lock of SM2 is held, and on threads that have no GIL. They are queued here. The
//! next call of the package that has waited or copied passes them on to the logger `sm2`.

use std::collections::VecDeque;
use std::fmt::{self, Write as _};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Mutex, MutexGuard, TryLockError};
use std::thread;

use pyo3::prelude::*;
use tracing::field::{Field, Visit};
use tracing::span::{Attributes, Id, Record};
use tracing::{Event, Level, Metadata};

/// The most records that wait; further ones are dropped, and counted.
const QUEUE_MAX: usize = 256;

/// How often a thread tries to lock the queue.
const TRIES: u32 = 1000;

/// Whether the queue may have records. Lets a call without records skip the lock.
static WAITING: AtomicBool = AtomicBool::new(false);

static QUEUE: Mutex<Queue> = Mutex::new(Queue {
    records: VecDeque::new(),
    dropped: 0,
});

struct Queue {
    records: VecDeque<LogRecord>,
    dropped: u64,
}

struct LogRecord {
    /// Python's number for the level.
    level: u8,
    text: String,
}

/// Makes SM2's warnings of this process go to the queue. Called once.
pub(crate) fn install() {
    // It is set already if the module is imported by a second interpreter of this process.
    let _ = tracing::subscriber::set_global_default(ToQueue);
}

/// Passes all queued records on to Python's `logging`.
pub(crate) fn forward(py: Python<'_>) {
    if !WAITING.swap(false, Ordering::AcqRel) {
        return;
    }
    let (records, dropped) = {
        let Some(mut queue) = queue() else {
            return;
        };
        (
            std::mem::take(&mut queue.records),
            std::mem::take(&mut queue.dropped),
        )
    };
    if let Err(error) = log_all(py, records, dropped) {
        // An exception of a handler must not end the call that happens to forward its record.
        error.write_unraisable(py, None);
    }
}

fn log_all(py: Python<'_>, records: VecDeque<LogRecord>, dropped: u64) -> PyResult<()> {
    let logger = py.import("logging")?.call_method1("getLogger", ("sm2",))?;
    for LogRecord { level, text } in records {
        logger.call_method1("log", (level, "%s", text))?;
    }
    if dropped > 0 {
        logger.call_method1("warning", ("%d further warnings were dropped", dropped))?;
    }
    Ok(())
}

/// The queue; `None` if its lock does not become free. Each holder releases it at once, except a thread of the parent
/// that a forked child does not have.
fn queue() -> Option<MutexGuard<'static, Queue>> {
    for _ in 0..TRIES {
        match QUEUE.try_lock() {
            Ok(queue) => return Some(queue),
            Err(TryLockError::Poisoned(queue)) => return Some(queue.into_inner()),
            Err(TryLockError::WouldBlock) => thread::yield_now(),
        }
    }
    None
}

/// A subscriber of `tracing` that queues warnings and errors.
struct ToQueue;

impl tracing::Subscriber for ToQueue {
    fn enabled(&self, metadata: &Metadata<'_>) -> bool {
        metadata.is_event() && *metadata.level() <= Level::WARN
    }

    fn event(&self, event: &Event<'_>) {
        let mut text = Text::default();
        event.record(&mut text);
        let level = if *event.metadata().level() == Level::ERROR {
            40
        } else {
            30
        };
        let Some(mut queue) = queue() else {
            return;
        };
        if queue.records.len() < QUEUE_MAX {
            let text = text.0;
            queue.records.push_back(LogRecord { level, text });
        } else {
            queue.dropped += 1;
        }
        WAITING.store(true, Ordering::Release);
    }

    // There are no spans, because none is enabled.
    fn new_span(&self, _: &Attributes<'_>) -> Id {
        Id::from_u64(1)
    }

    fn record(&self, _: &Id, _: &Record<'_>) {}

    fn record_follows_from(&self, _: &Id, _: &Id) {}

    fn enter(&self, _: &Id) {}

    fn exit(&self, _: &Id) {}
}

/// The text of an event: its message, then its fields.
#[derive(Default)]
struct Text(String);

impl Visit for Text {
    fn record_debug(&mut self, field: &Field, value: &dyn fmt::Debug) {
        // Writing to a string does not fail.
        let _ = match field.name() {
            "message" if self.0.is_empty() => write!(self.0, "{value:?}"),
            "message" => {
                let fields = std::mem::take(&mut self.0);
                write!(self.0, "{value:?} {}", fields.trim_start())
            }
            name => write!(self.0, " {name}={value:?}"),
        };
    }
}
