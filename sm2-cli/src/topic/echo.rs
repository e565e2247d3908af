//! `sm2 topic echo`: the messages of a topic, printed or written to files.

use std::{borrow::Cow, fmt, os::fd::AsFd, path::Path};

use serde::Serialize;
use sm2_io::clock;
use sm2_node::{Sample, Subscriber};
use sm2_proto::Kind;

use super::{EchoArguments, folder::Folder, hint};
use crate::{
    Ended,
    connect::Session,
    error::CliError,
    interrupt::Stopped,
    output::Output,
    size::Size,
    text::{Hex, write_message},
    wait::For,
};

/// How many messages of a publisher wait to be printed before the oldest is dropped.
const DEPTH: u16 = 64;

/// Echoes until a signal comes, or `--count` messages are there.
pub(super) fn run(arguments: &EchoArguments) -> Result<Ended, CliError> {
    let session = Session::open(&arguments.domain, "echo")?;
    let mut sink = Sink::new(arguments)?;
    let subscriber = session
        .node
        .subscriber_builder::<[u8]>(arguments.topic.as_str())
        .any_type()
        .depth(DEPTH)
        .reliable(arguments.reliable)
        .declare()?;
    let mut tally = Tally::default();
    let end = echo(arguments, &session, &subscriber, &mut sink, &mut tally)?;
    sink.out.flush()?;
    eprintln!("{tally}");
    Ok(match end {
        // Ctrl-C is how it ends that has no other end.
        Some(signal) if arguments.count.is_some() => Ended::Stopped(signal),
        _ => Ended::Done,
    })
}

/// The loop; the signal that ended it, if one did.
fn echo(
    arguments: &EchoArguments,
    session: &Session,
    subscriber: &Subscriber<[u8]>,
    sink: &mut Sink<'_>,
    tally: &mut Tally,
) -> Result<Option<Stopped>, CliError> {
    let mut hint_at = Some(clock::now().after(hint::AFTER));
    while arguments.count.is_none_or(|count| tally.messages < count) {
        if let Some(signal) = session.stopped() {
            return Ok(Some(signal));
        }
        if let Some(sample) = subscriber.try_recv()? {
            hint_at = None;
            tally.add(&sample);
            sink.take(&sample)?;
            continue;
        }
        sink.out.flush()?;
        if hint_at.is_some_and(|at| at <= clock::now()) {
            hint_at = None;
            if !subscriber.links().iter().any(|link| link.open) {
                hint::say(session, &arguments.topic, Kind::Publisher, 1);
            }
        }
        let others = [
            (subscriber.as_fd(), For::Reading),
            // `… | head` has ended: nobody waits for the next message.
            (sink.out.as_fd(), For::Hangup),
        ];
        if session.step(&others, hint_at)?[1] {
            return Ok(None);
        }
    }
    Ok(None)
}

/// Where messages go.
struct Sink<'a> {
    arguments: &'a EchoArguments,
    out: Output,
    folder: Option<Folder>,
}

/// A message as a line of JSON.
#[derive(Serialize)]
struct Line<'a> {
    topic: &'a str,
    /// Its publisher's node.
    publisher: &'a str,
    /// Its publisher's count of messages.
    sequence: u64,
    /// When it was published, on the host's monotonic clock.
    source_time_ns: u64,
    /// How many messages of this publisher are missing before it.
    lost: u64,
    len_bytes: usize,
    #[serde(flatten)]
    content: Content<'a>,
}

#[derive(Serialize)]
#[serde(rename_all = "snake_case")]
enum Content<'a> {
    Text(&'a str),
    Hex(String),
    File(Cow<'a, str>),
}

impl<'a> Sink<'a> {
    fn new(arguments: &'a EchoArguments) -> Result<Self, CliError> {
        let folder = arguments.to_dir.as_deref().map(Folder::open).transpose()?;
        Ok(Self {
            arguments,
            out: Output::new(),
            folder,
        })
    }

    fn take(&mut self, sample: &Sample<[u8]>) -> Result<(), CliError> {
        let path = match &mut self.folder {
            Some(folder) => Some(folder.store(sample)?),
            None => None,
        };
        match (self.arguments.json, path) {
            (true, path) => self
                .out
                .json(&Line::new(self.arguments, sample, path.as_deref())),
            (false, None) => self.out.write(|out| write_message(out, sample)),
            (false, Some(_)) => Ok(()),
        }
    }
}

impl<'a> Line<'a> {
    fn new(arguments: &'a EchoArguments, sample: &'a Sample<[u8]>, file: Option<&'a Path>) -> Self {
        let content = match (file, str::from_utf8(sample)) {
            (Some(path), _) => Content::File(path.to_string_lossy()),
            (None, Ok(text)) => Content::Text(text),
            (None, Err(_)) => Content::Hex(Hex(sample, "").to_string()),
        };
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

/// What is said at the end.
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
        let many = if messages == 1 { "" } else { "s" };
        write!(
            f,
            "received {messages} message{many} ({}), lost {lost}",
            Size(bytes)
        )
    }
}
