//! `sm2 demo`: measures large messages on this machine, and a lossy link between two domains.

use std::os::fd::AsFd;

use clap::Args;
use sm2_demo::{
    Ending, Format, Options, ProcessArguments, SIZE_MIN_BYTES, one_domain, two_domains,
};

use crate::{
    args::{Integrity, positive},
    ended::Ended,
    error::CliError,
    interrupt::Interrupt,
    output::Output,
    size::Size,
};

/// `sm2 demo`.
#[derive(Args, Clone, Debug)]
#[command(after_help = HELP)]
pub(crate) struct Arguments {
    /// The number of subscribers, each a process
    #[arg(long, value_name = "N", default_value_t = 5, value_parser = clap::value_parser!(u32).range(1..=256))]
    pub(super) subscribers: u32,
    /// The size of a message, such as 64kB [default: 10MB; with --bad-link 1MB]
    #[arg(long, value_name = "SIZE", value_parser = size)]
    pub(super) size: Option<Size>,
    /// The number of messages per second
    #[arg(long, value_name = "HZ", default_value_t = 30.0, value_parser = positive, allow_negative_numbers = true)]
    pub(super) rate: f64,
    /// The time of publishing in seconds [default: 10; with --bad-link 30]
    #[arg(long, value_name = "SECONDS", value_parser = positive, allow_negative_numbers = true)]
    pub(super) seconds: Option<f64>,
    /// Reuse shared memory, or seal each message, so that nobody can change it after publishing
    #[arg(long, value_enum, default_value_t = Integrity::Pooled)]
    pub(super) integrity: Integrity,
    /// Use two domains with a bad link between their gateways, and a subscriber in each. As root, the link is made
    /// of network namespaces, else it is a relay in this process
    #[arg(long, conflicts_with_all = ["subscribers", "integrity"])]
    pub(super) bad_link: bool,
    /// Print only one JSON object, at the end
    #[arg(long)]
    pub(super) json: bool,
}

const HELP: &str = "\
Every subscriber checks every byte of every message. Latency is the time from publishing to receiving,
without the check. CPU is the processor time of all processes; 100 % is one processor. PSS is the
memory of all processes; shared pages count once.

Exit status: 0 every subscriber received messages and none was damaged, 1 failed, 2 wrong usage, 130
Ctrl-C before the end (the report then covers the messages so far, and JSON has `interrupted`).

Examples:
  sm2 demo
  sm2 demo --subscribers 2 --size 1MiB --rate 100 --integrity sealed
  sm2 demo --seconds 3 --json | tail -n 1
  sm2 demo --bad-link --json | tail -n 1";

impl Arguments {
    fn options(&self, format: Format) -> Options {
        let (size_bytes, seconds) = match self.bad_link {
            true => (1_000_000, 30.0),
            false => (10_000_000, 10.0),
        };
        Options {
            subscribers: self.subscribers,
            size_bytes: self.size.map_or(size_bytes, |size| size.0),
            rate_hz: self.rate,
            seconds: self.seconds.unwrap_or(seconds),
            is_sealed: self.integrity == Integrity::Sealed,
            format,
        }
    }
}

/// Runs the demo.
///
/// # Errors
///
/// [`CliError::Demo`], [`CliError::Output`], [`CliError::System`], [`CliError::File`].
pub(crate) fn run(arguments: &Arguments) -> Result<Ended, CliError> {
    // The processes of the demo inherit it.
    sm2_io::raise_descriptor_limit();
    let interrupt = Interrupt::install().map_err(CliError::system("catch signals"))?;
    let mut out = Output::new();
    let format = match (arguments.json, out.is_terminal()) {
        (true, _) => Format::Json,
        (false, true) => Format::Terminal,
        (false, false) => Format::Lines,
    };
    let options = arguments.options(format);
    let demo = match arguments.bad_link {
        true => two_domains::run,
        false => one_domain::run,
    };
    let ending = demo(&options, out.writer(), interrupt.as_fd())?;
    Ok(match (ending, interrupt.signal()) {
        (Ending::Stopped, Some(signal)) => Ended::Stopped(signal),
        (Ending::Complete, _) | (Ending::Stopped, None) => Ended::Done,
        (Ending::Bad, _) => Ended::No,
    })
}

/// Runs one process of the demo.
///
/// # Errors
///
/// [`CliError::Output`].
pub(crate) fn run_process(arguments: &ProcessArguments) -> Result<Ended, CliError> {
    one_domain::process::run(arguments)?;
    Ok(Ended::Done)
}

fn size(text: &str) -> Result<Size, String> {
    match text.parse::<Size>() {
        Ok(size) if size.0 < SIZE_MIN_BYTES => Err(format!("give at least {SIZE_MIN_BYTES} bytes")),
        result => result.map_err(|error| error.to_string()),
    }
}
