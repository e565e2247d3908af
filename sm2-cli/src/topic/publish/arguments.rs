//! The arguments of `sm2 topic pub`.

use std::time::Duration;

use clap::{ArgGroup, Args};
use sm2_node::{MissedTicks, Timer};
use sm2_proto::{Name, schema::Schema};

use super::super::source::{Input, Split};
use crate::{
    args::{Domain, Integrity, name, positive},
    ros_types::Definitions,
    size::{MESSAGE_MAX_BYTES, Size},
    time,
};

/// `sm2 topic pub`.
#[derive(Args, Debug)]
#[command(after_help = HELP, group = ArgGroup::new("input").required(true))]
pub(crate) struct Arguments {
    /// The topic
    #[arg(value_name = "NAME", value_parser = name)]
    pub(super) topic: Name,
    /// A file (one message), a folder (each file, by name), or `-` (each line of standard input)
    #[arg(long, value_name = "PATH|-", value_parser = input, group = "input")]
    pub(super) from: Option<Input>,
    /// A message as JSON, encoded by the schema of its type; repeated with --rate and --loop
    #[arg(
        long,
        value_name = "JSON",
        group = "input",
        conflicts_with_all = ["from", "lines", "chunk", "whole"],
        allow_hyphen_values = true
    )]
    pub(super) value: Option<String>,
    #[command(flatten)]
    parts: Parts,
    /// The number of messages per second [default: as fast as the input can be read]
    #[arg(long, value_name = "HZ", value_parser = positive, allow_negative_numbers = true)]
    pub(super) rate: Option<f64>,
    /// After a stall, send the messages that are overdue at once, instead of going on at the rate
    #[arg(long, requires = "rate")]
    pub(super) catch_up: bool,
    /// Start again at the end of the input, until Ctrl-C
    #[arg(long = "loop")]
    pub(super) again: bool,
    /// Wait for subscribers that want every message (`sm2 topic echo --reliable`)
    #[arg(long)]
    pub(super) reliable: bool,
    /// Offer a message at least once in this time, such as 100ms, to subscribers that demand it
    #[arg(long, value_name = "TIME", value_parser = time::span)]
    pub(super) deadline: Option<Duration>,
    /// Messages that are older than this, such as 100ms, are not delivered
    #[arg(long, value_name = "TIME", value_parser = time::span)]
    pub(super) lifespan: Option<Duration>,
    /// Offer a sign of life at least once in this time, such as 1s, to subscribers that demand it. Each message is one
    #[arg(long, value_name = "TIME", value_parser = time::span)]
    pub(super) liveliness: Option<Duration>,
    /// Reuse shared memory, or seal each message, so that nobody can change it after publishing
    #[arg(long, value_enum, default_value_t = Integrity::Pooled)]
    pub(super) integrity: Integrity,
    /// How much shared memory the messages may use, such as 64MiB [default: 256MiB, or 24 of the longest
    /// messages]. Half of it is kept for subscribers that release their samples
    #[arg(long, value_name = "SIZE")]
    pub(super) pool_limit: Option<Size>,
    /// The type of the messages [default: with --value the topic's, else bytes]. Without a hash, the topic's
    /// type of this name, else a built-in type such as text or f64-list, else one of ROS 2
    #[arg(long = "type", value_name = "NAME[:HASH]", value_parser = data_type)]
    pub(super) data: Option<DataType>,
    /// The schema of --type, as `sm2 topic info` prints it. It determines the hash of the type
    #[arg(long, value_name = "TEXT", requires = "data", value_parser = schema)]
    pub(super) schema: Option<Schema>,
    #[command(flatten)]
    pub(super) definitions: Definitions,
    /// Start when this number of subscribers is linked
    #[arg(long, value_name = "N", default_value_t = 1)]
    pub(super) wait: usize,
    /// Print the counts at the end as one JSON object, on standard output
    #[arg(long)]
    pub(super) json: bool,
    #[command(flatten)]
    pub(super) domain: Domain,
}

/// How the input is split into messages.
#[derive(Args, Clone, Debug)]
#[group(multiple = false)]
struct Parts {
    /// Each line is a message, without its newline
    #[arg(long)]
    lines: bool,
    /// Every SIZE bytes are a message, such as 4096, 64kB or 1MiB
    #[arg(long, value_name = "SIZE", value_parser = chunk)]
    chunk: Option<Size>,
    /// The whole input is one message, even standard input
    #[arg(long)]
    whole: bool,
}

const HELP: &str = "\
With --reliable on both sides, a message is lost only if its subscriber takes no message for 10 s.
Otherwise a slow subscriber loses messages; standard error has their number.

pub continues while the Manager is replaced, and reports that on standard error.

Exit status: 0 all messages were published (or Ctrl-C with --loop), 1 failed, 2 wrong usage, 130 Ctrl-C
before the end.

Examples:
  echo hello | sm2 topic pub chatter --from -
  sm2 topic pub camera --from frames/ --rate 30 --loop
  sm2 topic pub log --from /var/log/syslog --lines --reliable
  sm2 topic pub range --type f64 --value 1.5 --rate 10 --loop
  sm2 topic pub goal --type nav/Goal --schema 'plain:struct{x:f64,y:f64,}' --value '{\"x\": 1.5, \"y\": 0}'
  sm2 topic pub pose --type geometry_msgs/msg/Pose2D --value '{\"x\": 1.5}' --rate 10 --loop
  sm2 topic pub blob --from - --chunk 1MiB --reliable < disk.img";

impl Arguments {
    /// How the input is split into messages.
    pub(super) fn split(&self) -> Split {
        match (&self.parts, &self.from) {
            (Parts { lines: true, .. }, _) => Split::Lines,
            (
                Parts {
                    chunk: Some(size), ..
                },
                _,
            ) => Split::Chunks(size.0),
            (Parts { whole: true, .. }, _) | (_, Some(Input::Path(_)) | None) => Split::Whole,
            (_, Some(Input::StandardInput)) => Split::Lines,
        }
    }

    /// The times of the messages after the first one, which is due now. After a stall, one message is due at once, and
    /// the schedule goes on with the present, unless it catches up: a burst of messages would displace messages of
    /// subscribers that are not reliable.
    pub(super) fn ticks(&self, hz: f64) -> Timer {
        let period = Duration::try_from_secs_f64(1.0 / hz).unwrap_or(Duration::MAX);
        Timer::every(period).missed_ticks(match self.catch_up {
            true => MissedTicks::Burst,
            false => MissedTicks::Skip,
        })
    }
}

/// The value of `--type`.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct DataType {
    pub(super) name: Name,
    /// `None` if the name alone determines the type.
    pub(super) hash: Option<u64>,
}

fn data_type(text: &str) -> Result<DataType, String> {
    let (name_text, hash) = match text.split_once(':') {
        None => (text, None),
        Some((name_text, digits)) => {
            let hash = u64::from_str_radix(digits, 16);
            let hash = hash.map_err(|_| "a schema hash is up to 16 hex digits".to_owned())?;
            (name_text, Some(hash))
        }
    };
    let name = name(name_text)?;
    Ok(DataType { name, hash })
}

fn input(text: &str) -> Result<Input, String> {
    match text {
        "" => Err("name a file or folder, or `-` for standard input".into()),
        "-" => Ok(Input::StandardInput),
        path => Ok(Input::Path(path.into())),
    }
}

fn chunk(text: &str) -> Result<Size, String> {
    match text.parse::<Size>() {
        Ok(size) if size.0 > MESSAGE_MAX_BYTES => {
            Err(format!("a chunk is at most {}", Size(MESSAGE_MAX_BYTES)))
        }
        result => result.map_err(|error| error.to_string()),
    }
}

fn schema(text: &str) -> Result<Schema, String> {
    Schema::parse(text).map_err(|error| error.to_string())
}

#[cfg(test)]
mod tests {
    use clap::Parser;
    use sm2_proto::Instant;

    use super::*;

    #[derive(Parser)]
    struct Command {
        #[command(flatten)]
        arguments: Arguments,
    }

    /// How many messages are due after a stall of 20 periods.
    fn overdue(options: &[&str]) -> usize {
        let line = ["pub", "topic", "--value", "1", "--rate", "10"];
        let Command { arguments } = Command::parse_from(line.iter().chain(options));
        let mut ticks = arguments.ticks(10.0);
        let first = ticks.deadline().unwrap();
        let late = Instant(first.0 + 20 * 100_000_000);
        std::iter::from_fn(|| ticks.handle(late)).count()
    }

    #[test]
    fn no_burst_follows_a_stall_unless_it_is_asked_for() {
        assert_eq!(overdue(&[]), 1);
        assert_eq!(overdue(&["--catch-up"]), 21);
    }
}
