//! `sm2 demo`: what large messages cost on this machine.
//!
//! One process publishes, several receive and check every byte; the Manager is in the demo's own
//! process. [`director`] starts, watches and ends them; [`publisher`] and [`subscriber`] are what
//! they do; [`part`] is how they talk.

mod bad_link;
mod child;
mod director;
mod folder;
mod meter;
mod part;
mod pattern;
mod procfs;
mod publisher;
mod report;
mod screen;
mod statistics;
mod subscriber;
mod table;

use std::{path::PathBuf, time::Duration};

use clap::{Args, Parser, ValueEnum};
use nix::sys::{prctl, signal::Signal};

use self::part::Said;
use crate::{
    Ended,
    args::{Integrity, positive},
    error::CliError,
    size::Size,
};

/// `sm2 demo`.
#[derive(Args, Clone, Debug)]
#[command(after_help = HELP)]
pub(crate) struct Arguments {
    /// How many processes receive
    #[arg(long, value_name = "N", default_value_t = 5, value_parser = clap::value_parser!(u32).range(1..=256))]
    pub(super) subscribers: u32,
    /// How large a message is, such as 64kB [default: 10MB; over a bad link 1MB]
    #[arg(long, value_name = "SIZE", value_parser = size)]
    pub(super) size: Option<Size>,
    /// How many messages are published each second
    #[arg(long, value_name = "HZ", default_value_t = 30.0, value_parser = positive, allow_negative_numbers = true)]
    pub(super) rate: f64,
    /// How long they are published, in seconds [default: 10; over a bad link 30]
    #[arg(long, value_name = "SECONDS", value_parser = positive, allow_negative_numbers = true)]
    pub(super) seconds: Option<f64>,
    /// Share messages in memory that is used again, or seal each, so that nobody can change it any more
    #[arg(long, value_enum, default_value_t = Integrity::Pooled)]
    pub(super) integrity: Integrity,
    /// Two domains with a bad link between their gateways: one subscriber beside the publisher, one behind the link.
    /// As root the link is made of network namespaces, else it is a relay of this process
    #[arg(long, conflicts_with_all = ["subscribers", "integrity"])]
    pub(super) bad_link: bool,
    /// Print nothing but one JSON object at the end
    #[arg(long)]
    pub(super) json: bool,
}

const HELP: &str = "\
Every subscriber checks every byte of every message. Latency is from publishing to receiving, before
the check. CPU is the processor time of all processes, 100 % being one processor. PSS is the memory
of all processes, with shared pages counted once.

Exit status: 0 if every subscriber received messages and none was damaged, else 1; 2 wrong usage; 130
Ctrl-C before the end, after the report of what there was (JSON says `interrupted`).

Examples:
  sm2 demo
  sm2 demo --subscribers 2 --size 1MiB --rate 100 --integrity sealed
  sm2 demo --seconds 3 --json | tail -n 1
  sm2 demo --bad-link --json | tail -n 1";

/// The first word of the command line that the demo starts its processes with.
pub(crate) const PART: &str = "demo-part";

/// What follows it.
#[derive(Clone, Debug, Parser)]
#[command(name = PART)]
pub(crate) struct PartArguments {
    #[arg(value_enum)]
    role: Role,
    /// The node's name.
    #[arg(long)]
    name: String,
    /// The demo's Manager.
    #[arg(long)]
    socket: PathBuf,
    /// Bytes of a message.
    #[arg(long)]
    size: u64,
    /// Nanoseconds between two messages.
    #[arg(long)]
    period: u64,
    /// How many messages there are.
    #[arg(long)]
    count: u64,
    /// How many subscribers there are.
    #[arg(long)]
    subscribers: u32,
    #[arg(long, value_enum)]
    integrity: Integrity,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum Role {
    Publisher,
    Subscriber,
}

/// The topic of the demo's own domain.
const TOPIC: &str = "demo";

/// How many messages are in memory at a time, where subscribers keep up more or less.
const SLOTS: u64 = 4;

/// How many messages a subscriber may be behind.
const DEPTH: u16 = 8;

impl Arguments {
    fn size(&self) -> Size {
        let default = if self.bad_link { 1_000_000 } else { 10_000_000 };
        self.size.unwrap_or(Size(default))
    }

    fn seconds(&self) -> f64 {
        let default = if self.bad_link { 30.0 } else { 10.0 };
        self.seconds.unwrap_or(default)
    }

    /// How many messages are published.
    fn count(&self) -> Result<u64, CliError> {
        // Saturates; both are positive.
        match (self.rate * self.seconds()).round() as u64 {
            count if count > statistics::MESSAGES_MAX => Err(CliError::DemoTooLong {
                count,
                limit: statistics::MESSAGES_MAX,
            }),
            count => Ok(count.max(1)),
        }
    }

    /// Refuses what would drive the machine out of memory.
    fn check_memory(&self) -> Result<(), CliError> {
        let size_bytes = self.size().0;
        let needed_bytes = size_bytes.saturating_mul(SLOTS);
        match procfs::available_bytes() {
            Some(available_bytes) if needed_bytes > available_bytes => {
                Err(CliError::DemoTooLarge {
                    size_bytes,
                    needed_bytes,
                    available_bytes,
                })
            }
            _ => Ok(()),
        }
    }

    fn period(&self) -> Duration {
        Duration::try_from_secs_f64(1.0 / self.rate).unwrap_or(Duration::MAX)
    }
}

/// Runs the demo.
///
/// # Errors
///
/// If a part failed or a message was damaged; if it could not be started at all.
pub(crate) fn run(arguments: &Arguments) -> Result<Ended, CliError> {
    arguments.check_memory()?;
    if arguments.bad_link {
        return bad_link::run(arguments);
    }
    director::direct(arguments, arguments.count()?)
}

/// Runs a part of it. What goes wrong is said to the demo, on standard output.
pub(crate) fn run_part(arguments: &PartArguments) -> Result<Ended, CliError> {
    // Without it the end of standard input would end this process too, only later.
    let _ = prctl::set_pdeathsig(Signal::SIGKILL);
    let result = match arguments.role {
        Role::Publisher => publisher::run(arguments),
        Role::Subscriber => subscriber::run(arguments),
    };
    let said = result.or_else(|error| {
        part::say(&Said::Failed {
            reason: error.to_string(),
        })
    });
    said.map_err(CliError::Output).map(|()| Ended::Done)
}

fn size(text: &str) -> Result<Size, String> {
    match text.parse::<Size>() {
        Ok(size) if size.0 < pattern::MIN_BYTES => {
            Err(format!("give at least {} bytes", pattern::MIN_BYTES))
        }
        result => result.map_err(|error| error.to_string()),
    }
}
