//! The protocol between the director and the processes of the demo.
//!
//! A process writes lines of JSON to its standard output. A line on its standard input tells it to
//! start. The end of its standard input tells it to end; this also happens when the director dies.

use std::io::{self, Write};

use serde::{Deserialize, Serialize};

use crate::statistics::Percentiles;

/// The topic of the demo's own domain.
pub(crate) const TOPIC: &str = "demo";

/// The number of messages that a subscriber may be behind.
pub(crate) const DEPTH: u16 = 8;

/// The line that starts the publisher.
pub(crate) const START: &[u8] = b"start\n";

/// One line of a process.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub(crate) enum ProcessEvent {
    /// The process is connected and has declared its interfaces; the publisher also has all its
    /// subscribers.
    Ready,
    /// Totals, and the rate and latencies of the last second; sent about every second.
    Progress(Figures),
    /// The figures of the whole run; sent at the end.
    Done(Figures),
    /// The process cannot continue.
    Failed {
        /// The reason, in one line.
        reason: String,
    },
}

/// The counts of a process.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub(crate) struct Figures {
    /// The number of published or received messages.
    pub(crate) messages: u64,
    /// The number of messages that are missing between received ones.
    pub(crate) lost: u64,
    /// The number of received messages that differ from the published ones.
    pub(crate) damaged: u64,
    /// The position of the first wrong byte.
    pub(crate) first_damage: Option<Spot>,
    /// Messages per second.
    pub(crate) hz: f64,
    /// Latency from publishing to receiving.
    pub(crate) latency_us: Percentiles,
}

/// A position in a message.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub(crate) struct Spot {
    /// The count of the received message, from 1.
    pub(crate) message: u64,
    /// The offset of the byte.
    pub(crate) offset: u64,
}

/// Sends a line to the director.
///
/// # Errors
///
/// Standard output is closed: the director is gone.
pub(crate) fn send_event(event: &ProcessEvent) -> io::Result<()> {
    let mut out = io::stdout().lock();
    serde_json::to_writer(&mut out, event)?;
    out.write_all(b"\n")?;
    out.flush()
}
