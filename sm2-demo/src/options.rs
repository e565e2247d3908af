//! The options of a demo, and how a run ends.

use std::time::Duration;

use crate::{error::DemoError, pattern, process_cost, statistics};

/// The length of the shortest message that the demo can check, in bytes.
pub const SIZE_MIN_BYTES: u64 = pattern::MIN_BYTES;

/// The number of messages that are in memory at a time, if subscribers keep up.
const SLOTS: u64 = 4;

/// The options of both demos.
#[derive(Clone, Debug)]
pub struct Options {
    /// The number of subscribers; [`two_domains`](crate::two_domains) always has two.
    pub subscribers: u32,
    /// The length of a message in bytes, at least [`SIZE_MIN_BYTES`].
    pub size_bytes: u64,
    /// The number of messages in a second, above 0.
    pub rate_hz: f64,
    /// How long messages are published, in seconds, above 0.
    pub seconds: f64,
    /// True if each message is sealed; false if messages share pooled memory.
    pub is_sealed: bool,
    /// The form of the output.
    pub format: Format,
}

/// The form of the output.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Format {
    /// Text on a terminal: a table that is redrawn each second, and a summary.
    Terminal,
    /// Text for a file or a pipe: a line each second, and a summary.
    Lines,
    /// One JSON object at the end.
    Json,
}

/// How a demo ended that did not fail.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Ending {
    /// All messages were published, and the result is good.
    Complete,
    /// All messages were published, and the report shows a bad result.
    Bad,
    /// The stop descriptor became readable before the end.
    Stopped,
}

impl Options {
    /// The number of messages to publish.
    pub(crate) fn count(&self) -> Result<u64, DemoError> {
        // The cast saturates; both factors are positive.
        match (self.rate_hz * self.seconds).round() as u64 {
            count if count > statistics::MESSAGES_MAX => Err(DemoError::TooLong {
                count,
                limit: statistics::MESSAGES_MAX,
            }),
            count => Ok(count.max(1)),
        }
    }

    /// Refuses a size that would drive the machine out of memory.
    pub(crate) fn check_memory(&self) -> Result<(), DemoError> {
        let needed_bytes = self.size_bytes.saturating_mul(SLOTS);
        match process_cost::available_bytes() {
            Some(available_bytes) if needed_bytes > available_bytes => Err(DemoError::TooLarge {
                size_bytes: self.size_bytes,
                needed_bytes,
                available_bytes,
            }),
            _ => Ok(()),
        }
    }

    /// The time between two messages.
    pub(crate) fn period(&self) -> Duration {
        Duration::try_from_secs_f64(1.0 / self.rate_hz).unwrap_or(Duration::MAX)
    }
}

#[cfg(test)]
mod tests;
