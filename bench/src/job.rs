//! What the processes of a run say to each other.
//!
//! The director starts each of them with a [`Job`] as its argument. Each prints lines of JSON,
//! [`Said`], and reads the words `go` and `stop` from its standard input, whose end says that
//! it is time to leave.

use std::path::PathBuf;

use serde::{Deserialize, Serialize};

use crate::stats::Spread;

/// The hidden subcommand of the processes of a run; its argument is a [`Job`] as JSON.
pub const ROLE_COMMAND: &str = "role";

/// Which peer, and where it has its files: one world for each case of a run.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Domain {
    /// Its name in the catalogue of peers.
    pub peer: String,
    /// A folder of this case alone, in memory.
    pub dir: PathBuf,
    /// No other run on this machine has it: for names in places that all share.
    pub tag: String,
    /// A TCP port that was free, on the loopback interface.
    pub port: u16,
    /// At which of two hosts, if the case has two: they have the folder in common, and no network
    /// but the [link](crate::link) between them.
    pub side: Option<Side>,
}

/// One of two hosts.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Side {
    /// Where the publisher is.
    Near,
    /// The other one.
    Far,
}

impl Side {
    /// One word for the names of files.
    #[must_use]
    pub const fn as_str(self) -> &'static str {
        match self {
            Self::Near => "near",
            Self::Far => "far",
        }
    }
}

/// A channel or service, and what the workload needs of it.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Channel {
    /// Letters, digits and `/`.
    pub name: String,
    /// No message is longer, in bytes.
    pub max_len: usize,
    /// How many messages wait for a subscriber, where the peer can be told.
    pub depth: usize,
    /// The workload is about messages that arrive: nothing may be dropped, where the peer can be
    /// told. Otherwise the peer's mode says.
    pub lossless: bool,
    /// How many subscribers, or clients, there will be.
    pub subscribers: usize,
}

/// What subscribers do with a message.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, clap::ValueEnum)]
#[serde(rename_all = "lowercase")]
pub enum Read {
    /// Every byte is read and compared with what was written.
    #[default]
    Full,
    /// The first 32 bytes are read.
    Header,
}

impl Read {
    /// Its name on the command line.
    #[must_use]
    pub const fn as_str(self) -> &'static str {
        match self {
            Self::Full => "full",
            Self::Header => "header",
        }
    }
}

/// On which cores the processes of a run are.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, clap::ValueEnum)]
pub enum Cores {
    /// Where the scheduler wants them.
    #[default]
    Free,
    /// Each on one core, the next one on the next core.
    Apart,
    /// All on the first core.
    Together,
}

/// A process of a run.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Job {
    /// Its world.
    pub domain: Domain,
    /// What it does there.
    pub role: Role,
    /// The one core that it runs on; any if it is not said.
    pub core: Option<usize>,
    /// The file of the network namespace that it is in, if it is not the director's.
    pub network: Option<PathBuf>,
}

/// What a process does.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub enum Role {
    /// The peer's daemon: a Manager, a router.
    Daemon,
    /// Publishes a stream.
    Publisher(Stream),
    /// Receives a stream.
    Subscriber {
        /// Of what.
        channel: Channel,
        /// How.
        read: Read,
        /// Which one of the subscribers it is, from 0.
        number: usize,
    },
    /// Receives a stream, and notes when each message came.
    Watcher {
        /// Of what.
        channel: Channel,
        /// How.
        read: Read,
        /// Which one it is, from 0.
        number: usize,
    },
    /// Sends, and waits for what comes back.
    Ping(RoundTrips),
    /// Sends back.
    Echo(RoundTrips),
    /// Calls a service.
    Client(RoundTrips),
    /// Serves.
    Server(RoundTrips),
    /// Has a channel, and listens to its neighbour's.
    Node {
        /// Which one it is, from 0.
        number: usize,
        /// Of how many.
        count: usize,
    },
    /// Ends with the first message of a channel.
    Joiner {
        /// Of which one.
        channel: Channel,
        /// When it was started, on the monotonic clock.
        started_ns: u64,
    },
    /// Moves messages within one process: what the memory allows.
    Memory(MemoryWork),
}

/// What a publisher sends.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Stream {
    /// Where.
    pub channel: Channel,
    /// The length of each message, in bytes.
    pub len: usize,
    /// How many in each second; as fast as possible if it is not said.
    pub rate_hz: Option<f64>,
    /// How long it publishes before it counts, in seconds.
    pub warm_up_s: f64,
    /// How long it counts, in seconds.
    pub seconds: f64,
    /// Messages say when they were published.
    pub stamped: bool,
}

/// Messages that go and come back.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct RoundTrips {
    /// Of this length, both ways, in bytes.
    pub len: usize,
    /// Whether both sides read all bytes.
    pub read: Read,
    /// Not more of them.
    pub count: usize,
    /// Not longer, in seconds.
    pub seconds: f64,
}

/// One message is written, and read so many times.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct MemoryWork {
    /// Its length, in bytes.
    pub len: usize,
    /// How many times it is read.
    pub readers: usize,
    /// How.
    pub read: Read,
    /// On so many threads at once, each with memory of its own.
    pub threads: usize,
    /// How long, in seconds.
    pub seconds: f64,
}

/// One line of a process.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Said {
    /// Everything is declared; with a publisher or client: everybody is there.
    Ready,
    /// The counted part begins.
    Measuring,
    /// The counted part is over.
    Measured,
    /// All that it has to tell.
    Done(Outcome),
    /// It cannot go on.
    Failed {
        /// Why, in one line.
        reason: String,
    },
}

/// What a process found out.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Outcome {
    /// It has no figures.
    Nothing,
    /// A publisher's.
    Published {
        /// How many counted messages it published.
        counted: u64,
        /// In how much time.
        seconds: f64,
    },
    /// A subscriber's.
    Received(Reception),
    /// A watcher's.
    Watched(Watch),
    /// Ping's, and a client's.
    RoundTrips {
        /// There and back.
        round_trip_ns: Spread,
        /// From handing over to having in hand, one way, by the clock that both sides read.
        one_way_ns: Spread,
        /// What came back otherwise than it was written.
        torn: u64,
    },
    /// From the start of the process to its first message.
    Joined {
        /// In nanoseconds.
        after_ns: u64,
    },
    /// Of the memory alone.
    Memory {
        /// How often all was written and read in one second.
        hz: f64,
        /// How long one writing and one reading took.
        one_way_ns: Spread,
    },
}

/// What a subscriber received of the counted messages.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Reception {
    /// How many.
    pub counted: u64,
    /// Of all messages: those that are not what was written.
    pub torn: u64,
    /// Of all messages: those that did not come after the one before.
    pub stale: u64,
    /// Of the counted ones: how many in each second, from the first to the last.
    pub hz: f64,
    /// From the beginning of writing to the end of reading.
    pub latency_ns: Spread,
    /// From handing over to having in hand.
    pub handover_ns: Spread,
}

/// What a watcher saw.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Watch {
    /// The messages that are what was written, in their order.
    pub arrivals: Vec<Arrival>,
    /// How many are not.
    pub torn: u64,
}

/// One message that came, with moments of the monotonic clock in nanoseconds.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Arrival {
    /// Its number.
    pub number: u64,
    /// When its writing began.
    pub start_ns: u64,
    /// When it was published.
    pub handed_ns: u64,
    /// When it was in hand.
    pub in_hand_ns: u64,
    /// When it had been read.
    pub read_ns: u64,
}

#[cfg(test)]
mod tests {
    use super::{Outcome, Read, Reception, Said};

    #[test]
    fn what_is_said_is_one_line_and_understood() {
        let said = Said::Done(Outcome::Received(Reception {
            counted: 3,
            hz: 1.5,
            ..Reception::default()
        }));
        let line = serde_json::to_string(&said).unwrap();
        assert!(!line.contains('\n'));
        assert_eq!(serde_json::from_str::<Said>(&line).unwrap(), said);
    }

    #[test]
    fn ways_of_reading_have_the_names_of_the_command_line() {
        for read in [Read::Full, Read::Header] {
            let json = serde_json::to_value(read).unwrap();
            assert_eq!(json, read.as_str());
        }
    }
}
