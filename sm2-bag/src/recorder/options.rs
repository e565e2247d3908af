//! The options of a recording, and its progress.

use std::collections::BTreeSet;
use std::time::Duration;

use sm2_node::clock::wall_time;
use sm2_proto::Name;

use crate::clock::{MonotonicClock, WallClock};
use crate::patterns::TopicPatterns;
use crate::storage::{FreeBytes, free_bytes};
use crate::writer::Compression;

/// The options of a recording.
#[derive(Clone, Debug)]
pub struct Options {
    /// The topics.
    pub topics: Topics,
    /// The topics whose publishers wait for the recorder instead of displacing messages. Each one needs a reliable
    /// publisher.
    pub reliable: BTreeSet<Name>,
    /// How many bytes of payloads may wait for the disk; 256 MiB by default. Messages beyond that are dropped, and
    /// become a [gap](crate::GapReason::Budget). Short messages that are in records already do not count; they are less
    /// than 8 MiB.
    pub budget_bytes: u64,
    /// Messages that are longer than this are left out, and become a [gap](crate::GapReason::TooLong); no limit by
    /// default, but no message that is longer than the budget finds room.
    pub max_len_bytes: u64,
    /// How often the recording is made safe against a power cut; every 100 ms by default.
    pub sync_interval: Duration,
    /// How chunks are compressed; not at all by default.
    pub compression: Compression,
    /// How many bytes of the disk stay free: the recording ends before, and a [`BlackBox`](crate::BlackBox) waits for
    /// room; 1 GiB by default. More than
    /// [`budget_bytes`](Self::budget_bytes), because messages that wait are still written.
    pub min_free_bytes: u64,
    /// How many bytes the disk of a file can still take; `fstatvfs(3)` by default. A [`Storage`](crate::Storage) knows
    /// it itself.
    pub free_bytes: FreeBytes,
    /// The wall clock; that of the machine by default.
    pub wall_clock: WallClock,
    /// The clock of the times of messages, files and incidents; the monotonic clock of the machine by default. Timeouts
    /// always follow the clock of the machine.
    pub monotonic_clock: MonotonicClock,
}

/// The topics to record.
#[derive(Clone, Debug)]
pub enum Topics {
    /// All topics that have a publisher, also those that come later.
    All,
    /// These topics, whether they have a publisher or not.
    Named(BTreeSet<Name>),
    /// These topics, whether they have a publisher or not, and all others that have a publisher and match, also those
    /// that come later.
    Matching(BTreeSet<Name>, TopicPatterns),
}

impl Topics {
    /// Whether a topic is recorded when it has a publisher.
    #[must_use]
    pub fn choose(&self, topic: &Name) -> bool {
        match self {
            Self::All => true,
            Self::Named(names) => names.contains(topic),
            Self::Matching(names, patterns) => {
                names.contains(topic) || patterns.choose(topic.as_str())
            }
        }
    }

    /// Whether a topic has its name here, and does not only match.
    pub(crate) fn is_named(&self, topic: &Name) -> bool {
        match self {
            Self::All => false,
            Self::Named(names) | Self::Matching(names, _) => names.contains(topic),
        }
    }

    /// The topics that have names.
    pub(crate) fn named(&self) -> impl Iterator<Item = Name> {
        let names = match self {
            Self::All => None,
            Self::Named(names) | Self::Matching(names, _) => Some(names),
        };
        names.into_iter().flatten().cloned()
    }
}

impl Options {
    /// The defaults for these topics.
    #[must_use]
    pub const fn new(topics: Topics) -> Self {
        Self {
            topics,
            reliable: BTreeSet::new(),
            budget_bytes: 256 << 20,
            max_len_bytes: u64::MAX,
            sync_interval: Duration::from_millis(100),
            compression: Compression::None,
            min_free_bytes: 1 << 30,
            free_bytes,
            wall_clock: wall_time,
            monotonic_clock: sm2_io::clock::now,
        }
    }
}

/// How far a recording is.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Progress {
    /// The number of topics with a subscriber.
    pub topics: usize,
    /// The number of topics that are not recorded now, because descriptors are short or the Manager refuses them.
    pub not_recorded: usize,
    /// The number of topics that were not recorded for a time so far, for these reasons.
    pub missing: usize,
    /// The number of messages in the file.
    pub messages: u64,
    /// The length of their payloads, in bytes.
    pub bytes: u64,
    /// The number of messages that are missing in the file.
    pub lost: u64,
    /// How many of them are longer than the [greatest length](Options::max_len_bytes).
    pub too_long: u64,
    /// The length of the payloads that wait for the disk, in bytes.
    pub waiting_bytes: u64,
    /// Whether the disk is full up to the [reserve](Options::min_free_bytes).
    pub is_disk_full: bool,
}

/// Why [`Recorder::step`](super::Recorder::step) has returned.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Step {
    /// The time is over.
    Timeout,
    /// The descriptor `stop` is readable.
    Stopped,
    /// The domain may have changed, or a [further source](super::Recorder::wake_on) may have something.
    Woken,
    /// The disk is full up to the [reserve](Options::min_free_bytes). Nothing more is taken;
    /// [`finish`](super::Recorder::finish) completes the bag.
    DiskFull,
}
