//! What the demo and its processes say to each other: lines of JSON on a part's standard output.
//! A part's standard input says when to start (a line) and when to end (its end of file,
//! which also comes when the demo dies).

use std::io::{self, Write};

use serde::{Deserialize, Serialize};

use crate::statistics::Percentiles;

/// The topic of the demo's own domain.
pub(crate) const TOPIC: &str = "demo";

/// The number of messages by which a subscriber may be behind.
pub(crate) const DEPTH: u16 = 8;

/// The line that starts the publisher.
pub(crate) const START: &[u8] = b"start\n";

/// One line of a part.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub(crate) enum Said {
    /// Connected and declared; the publisher also has all its subscribers.
    Ready,
    /// About every second: totals, and the rate and latencies of that second.
    Progress(Figures),
    /// At the end, of the whole run.
    Done(Figures),
    /// It cannot go on.
    Failed {
        /// Why, in one line.
        reason: String,
    },
}

/// What a part has counted.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub(crate) struct Figures {
    /// Messages published, or received.
    pub(crate) messages: u64,
    /// Messages that are missing between those received.
    pub(crate) lost: u64,
    /// Received messages that are not what was published.
    pub(crate) damaged: u64,
    /// Where the first of these is damaged.
    pub(crate) first_damage: Option<Spot>,
    /// Messages per second.
    pub(crate) hz: f64,
    /// From publishing to receiving.
    pub(crate) latency_us: Percentiles,
}

/// A place in a message.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub(crate) struct Spot {
    /// The count of the received message, from 1 on.
    pub(crate) message: u64,
    /// The byte.
    pub(crate) offset: u64,
}

/// Says it.
///
/// # Errors
///
/// What standard output says: the demo is gone.
pub(crate) fn say(said: &Said) -> io::Result<()> {
    let mut out = io::stdout().lock();
    serde_json::to_writer(&mut out, said)?;
    out.write_all(b"\n")?;
    out.flush()
}
