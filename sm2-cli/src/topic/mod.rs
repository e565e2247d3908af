//! `sm2 topic`: publish, print and list topics.

mod echo;
mod folder;
mod hint;
mod list;
mod publish;
mod room;
mod source;

use std::path::PathBuf;

use clap::{Args, Subcommand};
use sm2_proto::Name;

pub(crate) use self::source::MESSAGE_MAX_BYTES;
use self::source::{Input, Split};
use crate::{
    Ended,
    args::{Domain, Integrity, name, positive},
    error::CliError,
    size::Size,
};

/// The commands.
#[derive(Debug, Subcommand)]
pub(crate) enum Command {
    /// Publish files, or what comes on standard input
    Pub(PubArguments),
    /// Print the messages of a topic, or write them to files
    Echo(EchoArguments),
    /// List the topics of a domain
    List(ListArguments),
}

/// `sm2 topic pub`.
#[derive(Args, Debug)]
#[command(after_help = PUB_HELP)]
pub(crate) struct PubArguments {
    /// The topic
    #[arg(value_name = "NAME", value_parser = name)]
    topic: Name,
    /// A file: one message. A folder: each file in the order of names. `-`: each line of standard input
    #[arg(long, value_name = "PATH|-", value_parser = input)]
    from: Input,
    #[command(flatten)]
    parts: Parts,
    /// Publish this many messages each second [default: as fast as they can be read]
    #[arg(long, value_name = "HZ", value_parser = positive, allow_negative_numbers = true)]
    rate: Option<f64>,
    /// Begin again at the end, until Ctrl-C
    #[arg(long = "loop")]
    again: bool,
    /// Offer to wait for subscribers that want every message (`sm2 topic echo --reliable`)
    #[arg(long)]
    reliable: bool,
    /// Share messages in memory that is used again, or seal each, so that nobody can change it any more
    #[arg(long, value_enum, default_value_t = Integrity::Pooled)]
    integrity: Integrity,
    /// The messages' type; its schema's hash is the topic's, if that is in use, unless it is given
    #[arg(long = "type", value_name = "NAME[:HASH]", default_value = "bytes", value_parser = data_type)]
    data: DataType,
    /// Begin when this many subscribers are there
    #[arg(long, value_name = "N", default_value_t = 1)]
    wait: usize,
    #[command(flatten)]
    domain: Domain,
}

/// What of an input is a message.
#[derive(Args, Clone, Debug)]
#[group(multiple = false)]
struct Parts {
    /// Each line is a message, without its newline
    #[arg(long)]
    lines: bool,
    /// Each SIZE bytes are a message, such as 4096, 64kB or 1MiB
    #[arg(long, value_name = "SIZE", value_parser = chunk)]
    chunk: Option<Size>,
    /// All is one message, also of standard input
    #[arg(long)]
    whole: bool,
}

const PUB_HELP: &str = "\
With --reliable on both sides no message is lost: the publisher waits for subscribers that are
behind, 10 s at most. Otherwise a subscriber that is too slow misses messages; standard error says
how many.

Exit status: 0 all published (or Ctrl-C with --loop), 1 failed, 2 wrong usage, 130 Ctrl-C before the end.

Examples:
  echo hello | sm2 topic pub chatter --from -
  sm2 topic pub camera --from frames/ --rate 30 --loop
  sm2 topic pub log --from /var/log/syslog --lines --reliable
  sm2 topic pub blob --from - --chunk 1MiB --reliable < disk.img";

/// `sm2 topic echo`.
#[derive(Args, Debug)]
#[command(after_help = ECHO_HELP)]
pub(crate) struct EchoArguments {
    /// The topic
    #[arg(value_name = "NAME", value_parser = name)]
    topic: Name,
    /// Write each message to a file of its own: DIR/000000.bin, DIR/000001.bin, ...
    #[arg(long, value_name = "DIR")]
    to_dir: Option<PathBuf>,
    /// End after so many messages
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u64).range(1..))]
    count: Option<u64>,
    /// Take every message: have the publisher wait, if it offers to
    #[arg(long)]
    reliable: bool,
    /// Print each message as one line of JSON
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    domain: Domain,
}

const ECHO_HELP: &str = "\
A message that is text (UTF-8 without control characters but newline and tab) is printed as it is;
of any other its length and first bytes. JSON has all of it: as `text` if it is UTF-8, else as `hex`,
or the `file` that it was written to.

Exit status: 0 ended by Ctrl-C or after --count messages, 1 failed, 2 wrong usage, 130 Ctrl-C before
--count messages came.

Examples:
  sm2 topic echo chatter
  sm2 topic echo camera --to-dir frames --count 10
  sm2 topic echo log --reliable --json | jq .text";

/// `sm2 topic list`.
#[derive(Args, Debug)]
#[command(after_help = LIST_HELP)]
pub(crate) struct ListArguments {
    /// Print one JSON object
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    domain: Domain,
}

const LIST_HELP: &str = "\
Examples:
  sm2 topic list
  sm2 topic list --json | jq -r '.topics[].name'";

/// Runs a command.
///
/// # Errors
///
/// What it failed with.
pub(crate) fn run(command: &Command) -> Result<Ended, CliError> {
    match command {
        Command::Pub(arguments) => publish::run(arguments),
        Command::Echo(arguments) => echo::run(arguments),
        Command::List(arguments) => list::run(arguments),
    }
}

impl PubArguments {
    fn split(&self) -> Split {
        match (&self.parts, &self.from) {
            (Parts { lines: true, .. }, _) => Split::Lines,
            (
                Parts {
                    chunk: Some(size), ..
                },
                _,
            ) => Split::Chunks(size.0),
            (Parts { whole: true, .. }, _) | (_, Input::Path(_)) => Split::Whole,
            (_, Input::StandardInput) => Split::Lines,
        }
    }
}

/// A type as a person names it.
#[derive(Clone, Debug, PartialEq, Eq)]
struct DataType {
    name: Name,
    /// None if the domain is to be asked.
    hash: Option<u64>,
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
