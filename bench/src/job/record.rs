//! The work of the processes of `record` and `seek`.

use std::path::PathBuf;

use serde::{Deserialize, Serialize};

use super::Channel;

/// A recording of several channels into one file.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Recording {
    /// The file, which does not exist yet.
    pub file: PathBuf,
    /// The channel of the frames. Its publisher waits for the recorder.
    pub frames: Channel,
    /// The channels of the small messages.
    pub small: Vec<Channel>,
    /// The time between two calls of `fdatasync(2)`, for a recorder that can do so, in milliseconds.
    pub sync_ms: u64,
}

impl Recording {
    /// All channels: that of the frames, and then those of the small messages.
    pub fn channels(&self) -> Vec<&Channel> {
        [&self.frames].into_iter().chain(&self.small).collect()
    }
}

/// Large messages that are published one after the other.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Frames {
    /// The channel that the frames are published on.
    pub channel: Channel,
    /// The length of each frame, in bytes.
    pub len: usize,
    /// The number of frames.
    pub count: u64,
    /// Frames per second; `None` is as fast as the subscribers take them.
    pub rate_hz: Option<f64>,
}

/// Small messages that one process publishes on many channels.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct SmallTopics {
    /// The channels.
    pub channels: Vec<Channel>,
    /// The length of each message, in bytes.
    pub len: usize,
    /// Messages per second on each channel.
    pub rate_hz: u64,
}

/// Blocks that are written to a file without any middleware.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct DiskWork {
    /// The file, which does not exist yet.
    pub file: PathBuf,
    /// The length of each write before rounding up to whole blocks, in bytes.
    pub len: usize,
    /// The number of writes.
    pub count: u64,
    /// The interval of `fdatasync(2)`, in milliseconds.
    pub sync_ms: u64,
}

/// The search for the first message from a time on.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Seek {
    /// The bag.
    pub file: PathBuf,
    /// The time of the wall clock, in nanoseconds.
    pub at_ns: u64,
    /// The topic of the message; `None` is any topic.
    pub topic: Option<String>,
}

/// The result of a publisher of frames.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Framed {
    /// The number of published frames.
    pub count: u64,
    /// The time before the first frame, on the monotonic clock.
    pub start_ns: u64,
    /// The time when all subscribers had taken the last frame.
    pub end_ns: u64,
    /// The time that the publisher neither wrote a frame nor waited for the next one to be due.
    pub blocked_ns: u64,
}

/// The result of a recorder, or of a writer of blocks.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Recorded {
    /// The time before the first write of a writer of blocks; for a recorder, the time when it was ready.
    pub start_ns: u64,
    /// The time when the file was complete and on the disk.
    pub done_ns: u64,
    /// The CPU time of the process from one to the other.
    pub cpu_ns: u64,
    /// The length of the file, in bytes.
    pub file_bytes: u64,
}

/// The result of a search.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Sought {
    /// The time for opening the bag, in nanoseconds.
    pub open_ns: u64,
    /// The time for opening the bag and reading the first message, in nanoseconds.
    pub first_ns: u64,
    /// The peak of the resident memory of the process (`VmHWM`), in bytes.
    pub peak_bytes: u64,
    /// The bytes that the process fetched from the disk meanwhile.
    pub fetched_bytes: u64,
}
