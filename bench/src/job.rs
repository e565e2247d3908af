//! The protocol between the director and the processes of a run.
//!
//! The director starts each process with a [`Job`] as its argument. The process prints one line of
//! JSON, a [`ProcessEvent`], per event. It reads the words `go` and `stop` from its standard input, and
//! exits when its standard input ends.

use std::path::PathBuf;

use serde::{Deserialize, Serialize};

use crate::stats::Spread;

pub use record::{DiskWork, Framed, Frames, Recorded, Recording, Seek, SmallTopics, Sought};

mod record;

/// The hidden subcommand of the processes of a run; its argument is a [`Job`] as JSON.
pub const ROLE_COMMAND: &str = "role";

/// The peer of a case, and the names and files that its processes share.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Domain {
    /// The name of the peer in the catalogue.
    pub peer: String,
    /// A folder in memory that belongs to this case alone.
    pub dir: PathBuf,
    /// A prefix for names in folders that all processes of the machine share; unique to this case.
    pub tag: String,
    /// A TCP port of the loopback interface that was free when the case began.
    pub port: u16,
    /// The host of the process, if the case has two hosts. They share the folder; their only
    /// network is the [link](crate::link) between them.
    pub side: Option<Side>,
}

/// One of the two hosts of a case.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Side {
    /// The host of the publisher.
    Near,
    /// The host of the remote subscriber.
    Far,
}

impl Side {
    /// The name of the side, as it stands in names of files.
    #[must_use]
    pub const fn as_str(self) -> &'static str {
        match self {
            Self::Near => "near",
            Self::Far => "far",
        }
    }
}

/// A topic or service of a peer, and the workload's requirements on it.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Channel {
    /// The name: letters, digits and `/`.
    pub name: String,
    /// The length of the longest message, in bytes.
    pub max_len: usize,
    /// The number of messages that a subscriber's queue holds, for peers that can configure it.
    pub depth: usize,
    /// True if nothing may be dropped, for peers that can configure it. Otherwise the mode of the
    /// peer decides.
    pub lossless: bool,
    /// The number of subscribers or clients that will come.
    pub subscribers: usize,
}

/// The part of a message that subscribers read.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, clap::ValueEnum)]
#[serde(rename_all = "lowercase")]
pub enum Read {
    /// Every byte is read and compared with the written one.
    #[default]
    Full,
    /// The first 32 bytes are read.
    Header,
}

impl Read {
    /// The name of the variant on the command line.
    #[must_use]
    pub const fn as_str(self) -> &'static str {
        match self {
            Self::Full => "full",
            Self::Header => "header",
        }
    }
}

/// The assignment of processes to cores.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, clap::ValueEnum)]
pub enum Cores {
    /// The scheduler of the kernel decides.
    #[default]
    Free,
    /// Each process is bound to one core, and the next process to the next core.
    Apart,
    /// All processes are bound to the first core.
    Together,
}

/// The description of one process of a run.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Job {
    /// The peer and its files.
    pub domain: Domain,
    /// The task of the process.
    pub role: Role,
    /// The core that the process is bound to, if any.
    pub core: Option<usize>,
    /// The file of the network namespace that the process enters; `None` is the director's.
    pub network: Option<PathBuf>,
}

/// The task of a process.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub enum Role {
    /// Runs the peer's daemon: a Manager or a router.
    Daemon,
    /// Publishes a stream.
    Publisher(Stream),
    /// Receives a stream.
    Subscriber {
        /// The channel of the stream.
        channel: Channel,
        /// The part of each message that the subscriber reads.
        read: Read,
        /// The index of the subscriber, from 0.
        number: usize,
    },
    /// Receives a stream, and records the arrival of each message.
    Watcher {
        /// The channel of the stream.
        channel: Channel,
        /// The part of each message that the watcher reads.
        read: Read,
        /// The index of the watcher, from 0.
        number: usize,
    },
    /// Sends messages, and waits for each to come back.
    Ping(RoundTrips),
    /// Sends each message back.
    Echo(RoundTrips),
    /// Calls a service.
    Client(RoundTrips),
    /// Serves the calls of the client.
    Server(RoundTrips),
    /// Publishes on a channel of its own, and subscribes to the channel of the next node.
    Node {
        /// The index of the node, from 0.
        number: usize,
        /// The number of nodes.
        count: usize,
    },
    /// Receives one message, and reports the time since its start.
    Joiner {
        /// The channel that the process subscribes to.
        channel: Channel,
        /// The time when the director started the process, on the monotonic clock.
        started_ns: u64,
    },
    /// Writes and reads messages within one process, to measure the memory alone.
    Memory(MemoryWork),
    /// Publishes a number of frames.
    Frames(Frames),
    /// Publishes small messages on many channels.
    SmallTopics(SmallTopics),
    /// Records channels into a file.
    Recorder(Recording),
    /// Writes blocks to a file, to measure the disk alone.
    DiskWriter(DiskWork),
    /// Searches a bag for the first message from a time on.
    Seeker(Seek),
}

/// The messages of a publisher.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Stream {
    /// The channel that the messages are published on.
    pub channel: Channel,
    /// The length of each message, in bytes.
    pub len: usize,
    /// Messages per second; `None` is as fast as possible.
    pub rate_hz: Option<f64>,
    /// The time before the counted part, in seconds.
    pub warm_up_s: f64,
    /// The duration of the counted part, in seconds.
    pub seconds: f64,
    /// True if messages carry the time of their publication.
    pub stamped: bool,
}

/// Messages that travel to another process and back.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct RoundTrips {
    /// The length of each message in both directions, in bytes.
    pub len: usize,
    /// The part of each message that both sides read.
    pub read: Read,
    /// The largest number of round trips.
    pub count: usize,
    /// The longest duration, in seconds.
    pub seconds: f64,
}

/// Messages that one process writes and reads.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct MemoryWork {
    /// The length of each message, in bytes.
    pub len: usize,
    /// The number of times that each message is read.
    pub readers: usize,
    /// The part of the message that is read.
    pub read: Read,
    /// The number of threads. Each has memory of its own.
    pub threads: usize,
    /// The duration, in seconds.
    pub seconds: f64,
}

/// One line of output of a process.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum ProcessEvent {
    /// The process has declared its interfaces.
    Ready,
    /// The counted part begins.
    Measuring,
    /// The counted part is over.
    Measured,
    /// The process is done.
    Done(Outcome),
    /// The process cannot continue.
    Failed {
        /// The reason, in one line.
        reason: String,
    },
}

/// The results of one process.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Outcome {
    /// The process has no figures.
    Nothing,
    /// The result of a publisher.
    Published {
        /// The number of counted messages.
        counted: u64,
        /// The duration of the counted part.
        seconds: f64,
    },
    /// The result of a subscriber.
    Received(Reception),
    /// The result of a watcher.
    Watched(Watch),
    /// The result of a ping or of a client.
    RoundTrips {
        /// Durations of round trips.
        round_trip_ns: Spread,
        /// Durations from publishing to receiving, one way, by the clock that both sides read.
        one_way_ns: Spread,
        /// The number of messages that differ from the written ones.
        torn: u64,
    },
    /// The result of a joiner.
    Joined {
        /// The time from the start of the process to its first message, in nanoseconds.
        after_ns: u64,
    },
    /// The result of [`Role::Memory`].
    Memory {
        /// Messages per second that were written and read by all readers.
        hz: f64,
        /// Durations of one write with all its reads.
        one_way_ns: Spread,
    },
    /// The result of a publisher of frames.
    Framed(Framed),
    /// The result of [`Role::SmallTopics`].
    SmallTopics {
        /// The number of messages that were published on each channel.
        published: Vec<u64>,
    },
    /// The result of a recorder, or of a writer of blocks.
    Recorded(Recorded),
    /// The result of [`Role::Seeker`].
    Sought(Sought),
}

/// The messages that a subscriber received.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Reception {
    /// The number of counted messages.
    pub counted: u64,
    /// The number of messages that differ from the written ones, counted or not.
    pub torn: u64,
    /// The number of messages that are not newer than the one before, counted or not.
    pub stale: u64,
    /// Counted messages per second, from the first to the last.
    pub hz: f64,
    /// Durations from the start of writing to the end of reading.
    pub latency_ns: Spread,
    /// Durations from publishing to receiving.
    pub handover_ns: Spread,
}

/// The messages that a watcher received.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Watch {
    /// The intact messages, in the order of their arrival.
    pub arrivals: Vec<Arrival>,
    /// The number of messages that differ from the written ones.
    pub torn: u64,
}

/// One received message, with times of the monotonic clock in nanoseconds.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Arrival {
    /// The number of the message.
    pub number: u64,
    /// The time when the publisher began to write the message.
    pub start_ns: u64,
    /// The time when the message was published.
    pub handed_ns: u64,
    /// The time when the watcher received the message.
    pub in_hand_ns: u64,
    /// The time when the watcher had read the message.
    pub read_ns: u64,
}

#[cfg(test)]
mod tests {
    use super::{Outcome, ProcessEvent, Read, Reception};

    #[test]
    fn what_is_said_is_one_line_and_understood() {
        let event = ProcessEvent::Done(Outcome::Received(Reception {
            counted: 3,
            hz: 1.5,
            ..Reception::default()
        }));
        let line = serde_json::to_string(&event).unwrap();
        assert!(!line.contains('\n'));
        assert_eq!(serde_json::from_str::<ProcessEvent>(&line).unwrap(), event);
    }

    #[test]
    fn ways_of_reading_have_the_names_of_the_command_line() {
        for read in [Read::Full, Read::Header] {
            let json = serde_json::to_value(read).unwrap();
            assert_eq!(json, read.as_str());
        }
    }
}
