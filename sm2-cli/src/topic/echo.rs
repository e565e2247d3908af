//! `sm2 topic echo`: the messages of a topic, printed or written to files.

use std::{fmt, io::Write, os::fd::AsFd, path::PathBuf, time::Duration};

use clap::Args;
use serde::Serialize;
use sm2_io::clock;
use sm2_node::{Sample, Subscriber};
use sm2_proto::{Kind, Name, TypeId, text::Counted};

use super::{folder::Folder, wait_hint};
use crate::{
    args::{Domain, name, with_option},
    built_in::BuiltIn,
    connect::CommandNode,
    ended::Ended,
    error::CliError,
    interrupt::Stopped,
    messages::{self, Content, Schemas, Show},
    output::Output,
    ros_types::Definitions,
    size::Size,
    time,
    wait::For,
};

/// `sm2 topic echo`.
#[derive(Args, Debug)]
#[command(after_help = HELP)]
pub(crate) struct Arguments {
    /// The topic
    #[arg(value_name = "NAME", value_parser = name)]
    topic: Name,
    /// Write each message to a file of its own: DIR/000000.bin, DIR/000001.bin, ...
    #[arg(long, value_name = "DIR")]
    to_dir: Option<PathBuf>,
    /// Exit after this number of messages
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u64).range(1..))]
    count: Option<u64>,
    /// Receive every message of reliable publishers; other publishers do not match
    #[arg(long)]
    reliable: bool,
    /// Receive from publishers that offer a message at least once in this time, such as 100ms
    #[arg(long, value_name = "TIME", value_parser = time::span)]
    deadline: Option<Duration>,
    /// Receive from publishers that offer a sign of life at least once in this time, such as 1s
    #[arg(long, value_name = "TIME", value_parser = time::span)]
    liveliness: Option<Duration>,
    /// The type of the messages: a built-in type such as text, or one of ROS 2, such as sensor_msgs/msg/Image.
    /// Publishers with another definition of the type are not received [default: any type]
    #[arg(long = "type", value_name = "NAME", value_parser = name)]
    data: Option<Name>,
    #[command(flatten)]
    definitions: Definitions,
    /// The longest message to receive; publishers do not send longer ones here [default: 1GiB]
    #[arg(long, value_name = "SIZE")]
    max_len: Option<Size>,
    /// Print each message as one line of JSON
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    show: Show,
    #[command(flatten)]
    domain: Domain,
}

const HELP: &str = "\
A message whose type has a schema is printed with its fields. Text is printed as it is, if it is UTF-8
without control characters other than newline and tab. Of any other message, the length and the first
bytes are printed. JSON has the whole message: as `value` if its type has a schema, as `text` if it is
UTF-8, else as `hex`; or as `file`, the path of the file that --to-dir wrote. If a message of ROS 2 has
byte sequences, such as an image, or more than four million values, each list is cut after 32 elements.

echo continues while the Manager is replaced, and reports that on standard error.

Exit status: 0 ended by Ctrl-C or after --count messages, 1 failed, 2 wrong usage, 130 Ctrl-C before
--count messages came.

Examples:
  sm2 topic echo chatter
  sm2 topic echo scan --json | jq .value.ranges[0]
  sm2 topic echo camera --to-dir frames --count 10
  sm2 topic echo log --reliable --json | jq .text";

/// The number of messages of a publisher that may wait for printing. The oldest is dropped first.
const DEPTH: u16 = 64;

/// Runs the command until a signal comes or `--count` messages were received.
pub(super) fn run(arguments: &Arguments) -> Result<Ended, CliError> {
    let command_node = CommandNode::open(&arguments.domain, "echo")?;
    let mut sink = Sink::new(arguments, &command_node)?;
    let builder = command_node
        .node
        .subscriber_builder::<[u8]>(arguments.topic.as_str())
        .depth(DEPTH)
        .reliable(arguments.reliable);
    let builder = match &arguments.data {
        Some(name) => builder.type_id(data_type(arguments, &command_node, name)?),
        None => builder.any_type(),
    };
    let builder = with_option(builder, arguments.deadline, |it, time| it.deadline(time));
    let builder = with_option(builder, arguments.liveliness, |it, time| {
        it.liveliness(time)
    });
    let builder = with_option(builder, arguments.max_len, |it, size| it.max_len(size.0));
    let subscriber = builder.declare()?;
    let mut tally = Tally::default();
    let end = echo(arguments, &command_node, &subscriber, &mut sink, &mut tally)
        .and_then(|end| sink.out.flush().map(|()| end));
    // After a failure as well, such as a full disk: it tells how much came before.
    if !end.as_ref().is_err_and(CliError::is_broken_pipe) {
        stderr_line!("{tally}");
    }
    Ok(match end? {
        // Without --count, Ctrl-C is the regular end.
        Some(signal) if arguments.count.is_some() => Ended::Stopped(signal),
        _ => Ended::Done,
    })
}

/// The type of `--type`. Its schema is registered, so that others can read and write its messages.
fn data_type(
    arguments: &Arguments,
    command_node: &CommandNode,
    name: &Name,
) -> Result<TypeId, CliError> {
    let Some(BuiltIn { data, schema }) = arguments.definitions.known(name)? else {
        return Err(CliError::NoDefinition { name: name.clone() });
    };
    if let Some(text) = schema {
        command_node.node.register_schema(data.clone(), &text)?;
    }
    Ok(data)
}

/// Prints messages. Returns the signal that ended the loop, if one did.
fn echo(
    arguments: &Arguments,
    command_node: &CommandNode,
    subscriber: &Subscriber<[u8]>,
    sink: &mut Sink<'_>,
    tally: &mut Tally,
) -> Result<Option<Stopped>, CliError> {
    let mut hint_at = Some(clock::now().after(wait_hint::DELAY));
    while arguments.count.is_none_or(|count| tally.messages < count) {
        if let Some(signal) = command_node.stopped() {
            return Ok(Some(signal));
        }
        if let Some(sample) = subscriber.try_recv()? {
            hint_at = None;
            sink.take(&sample)?;
            tally.add(&sample);
            continue;
        }
        sink.out.flush()?;
        if hint_at.is_some_and(|at| at <= clock::now()) {
            hint_at = None;
            let links = subscriber.links();
            if !links.iter().any(|link| link.open) {
                wait_hint::print(command_node, &arguments.topic, Kind::Publisher, 1, &links);
            }
        }
        let others = [
            (subscriber.as_fd(), For::Reading),
            // The reader, such as `head`, may end while no message comes.
            (sink.out.as_fd(), For::Hangup),
        ];
        if command_node.step(&others, hint_at)?[1] {
            return Ok(None);
        }
    }
    Ok(None)
}

/// Prints or stores messages.
struct Sink<'a> {
    arguments: &'a Arguments,
    command_node: &'a CommandNode,
    schemas: Schemas,
    out: Output,
    folder: Option<Folder>,
}

/// A message as a line of JSON.
#[derive(Serialize)]
struct Line<'a> {
    topic: &'a str,
    /// The publisher's node.
    publisher: &'a str,
    /// The publisher's number of the message.
    sequence: u64,
    /// The time of publishing, on the host's monotonic clock.
    source_time_ns: u64,
    /// The number of messages of this publisher that were lost before this one.
    lost: u64,
    len_bytes: usize,
    #[serde(flatten)]
    content: Content<'a>,
}

impl<'a> Sink<'a> {
    fn new(arguments: &'a Arguments, command_node: &'a CommandNode) -> Result<Self, CliError> {
        let folder = arguments.to_dir.as_deref().map(Folder::open).transpose()?;
        Ok(Self {
            arguments,
            command_node,
            schemas: Schemas::new(&arguments.definitions),
            out: Output::new(),
            folder,
        })
    }

    fn take(&mut self, sample: &Sample<[u8]>) -> Result<(), CliError> {
        let Self {
            arguments,
            command_node,
            schemas,
            out,
            folder,
        } = self;
        let path = folder.as_mut().map(|it| it.store(sample)).transpose()?;
        // Messages that are not decoded need no schema.
        let data = sample.type_id();
        let data = data.filter(|data| path.is_none() && arguments.show.decodes(data));
        let schema = data.and_then(|data| schemas.shown(command_node, data));
        match (arguments.json, path) {
            (true, Some(path)) => {
                let content = Content::File(path.to_string_lossy());
                out.json(&Line::new(arguments, sample, content))
            }
            // Copies: the publisher may still be able to change the message while it is checked and decoded.
            (true, None) => {
                let message = sample.to_vec();
                let content = Content::new(&message, schema, arguments.show);
                out.json(&Line::new(arguments, sample, content))
            }
            (false, None) => {
                let message = sample.to_vec();
                let lines = messages::lines(&message, schema, arguments.show);
                out.write(|out| out.write_all(&lines))
            }
            (false, Some(_)) => Ok(()),
        }
    }
}

impl<'a> Line<'a> {
    fn new(arguments: &'a Arguments, sample: &'a Sample<[u8]>, content: Content<'a>) -> Self {
        Self {
            topic: arguments.topic.as_str(),
            publisher: sample.publisher().as_str(),
            sequence: sample.sequence(),
            source_time_ns: sample.source_time().0,
            lost: sample.lost(),
            len_bytes: sample.len(),
            content,
        }
    }
}

/// The counts that are printed at the end.
#[derive(Clone, Copy, Debug, Default)]
struct Tally {
    messages: u64,
    bytes: u64,
    lost: u64,
}

impl Tally {
    fn add(&mut self, sample: &Sample<[u8]>) {
        self.messages += 1;
        self.bytes += sample.len() as u64;
        self.lost += sample.lost();
    }
}

impl fmt::Display for Tally {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self {
            messages,
            bytes,
            lost,
        } = *self;
        write!(
            f,
            "received {} ({}), lost {lost}",
            Counted::new(messages, "message"),
            Size(bytes)
        )
    }
}
