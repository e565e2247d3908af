//! Prints the messages of bags.

use std::{
    collections::{BTreeSet, HashMap},
    io::Write,
    path::PathBuf,
    time::Duration,
};

use clap::Args;
use serde::Serialize;
use sm2_bag::{Bag, BagFiles, BagMessage, ReadError, Source};

use super::work::Work;
use crate::{
    bag_choice::Choice,
    ended::Ended,
    error::CliError,
    messages::{self, Content, Schemas, Show},
    output::Output,
    ros_types::Definitions,
    time::Span,
};

/// `sm2 bag cat`.
#[derive(Args, Debug)]
#[command(after_help = HELP)]
pub(crate) struct Arguments {
    /// The bag: a file, or a folder
    #[arg(value_name = "BAG")]
    file: PathBuf,
    #[command(flatten)]
    choice: Choice,
    /// End after this number of messages
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u64).range(1..))]
    count: Option<u64>,
    #[command(flatten)]
    definitions: Definitions,
    /// Print each message as one line of JSON
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    show: Show,
}

const HELP: &str = "\
Prints messages as `sm2 topic echo` does, in the order of their times. Before each message of a bag with
several chosen topics there is a line with its time since the start of the bag, its topic and its publisher.
JSON has the times, too: `log_time_ns` and `publish_time_ns`, since 1970. `repeated` messages of latched
publishers are those that the bag begins with although they were published before.

Damaged parts are told on standard error, and left out.

Exit status: 0 all chosen messages were printed, 1 failed or parts are damaged, 2 wrong usage.

Examples:
  sm2 bag cat drive.mcap --count 3
  sm2 bag cat drive.mcap --topic chatter --json | jq .text";

/// A message as a line of JSON.
#[derive(Serialize)]
struct Line<'a> {
    topic: &'a str,
    /// The publisher's node; `null` if another program has recorded it.
    publisher: Option<&'a str>,
    sequence: u32,
    log_time_ns: u64,
    publish_time_ns: u64,
    repeated: bool,
    len_bytes: usize,
    #[serde(flatten)]
    content: Content<'a>,
}

/// Runs the command.
///
/// # Errors
///
/// [`CliError::ReadBag`], [`CliError::NotInBag`], [`CliError::Output`].
pub(super) fn run(arguments: &Arguments) -> Result<Ended, CliError> {
    let files = BagFiles::find(&arguments.file)?;
    let mut work = Work::begin([&files])?;
    let bags = work.open(&files, "printing")?;
    arguments.choice.check(&bags, [].into_iter())?;
    let start_ns = bags.iter().filter_map(|it| it.report().start_ns).min();
    let mut cat = Cat::new(arguments, &bags, start_ns);
    let mut is_whole = true;
    let mut left = arguments.count.unwrap_or(u64::MAX);
    for (file, message) in sm2_bag::messages(&bags, &arguments.choice.filter(start_ns)) {
        match message {
            Ok(_) if left == 0 => break,
            Ok(message) => {
                left -= 1;
                cat.print(file, &message)?;
                if work.advance(message.data.len() as u64).is_break() {
                    return Err(work.error(ReadError::Stopped));
                }
            }
            Err(ReadError::Damaged { part, path }) => {
                is_whole = false;
                let path = path.display();
                stderr_line!("sm2: {path} is damaged, and printed without {part}");
            }
            Err(error) => return Err(error.into()),
        }
    }
    Ok(Ended::with_answer(is_whole))
}

/// Prints messages.
struct Cat<'a> {
    arguments: &'a Arguments,
    schemas: Schemas,
    out: Output,
    /// The publishers, by the numbers of the file and of the channel.
    sources: HashMap<(usize, u16), Source>,
    /// The start of the bag, if each message has a title.
    titles_from_ns: Option<u64>,
}

impl<'a> Cat<'a> {
    fn new(arguments: &'a Arguments, bags: &[Bag], start_ns: Option<u64>) -> Self {
        let filter = arguments.choice.filter(None);
        let mut topics = BTreeSet::new();
        let mut sources = HashMap::new();
        let all = bags.iter().enumerate();
        let all = all.flat_map(|(number, bag)| bag.sources().map(move |it| (number, it)));
        for (bag, (channel, source)) in all.filter(|(_, it)| filter.has_topic(&it.0.topic)) {
            topics.insert(channel.topic.clone());
            sources.extend(source.ok().map(|it| ((bag, channel.id), it)));
        }
        Self {
            arguments,
            schemas: Schemas::new(&arguments.definitions),
            out: Output::new(),
            sources,
            titles_from_ns: start_ns.filter(|_| topics.len() > 1),
        }
    }

    fn print(&mut self, file: usize, message: &BagMessage) -> Result<(), CliError> {
        let Self {
            arguments,
            schemas,
            out,
            sources,
            titles_from_ns,
        } = self;
        let source = sources.get(&(file, message.channel.id));
        let publisher = source.map(|it| it.publisher.as_str());
        let show = arguments.show;
        let decoded = source.filter(|it| show.decodes(&it.data));
        let schema = decoded.and_then(|it| schemas.shown_with(&it.data, it.schema.as_deref()));
        if arguments.json {
            return out.json(&Line {
                topic: &message.channel.topic,
                publisher,
                sequence: message.sequence,
                log_time_ns: message.log_time,
                publish_time_ns: message.publish_time,
                repeated: message.is_repeated(),
                len_bytes: message.data.len(),
                content: Content::new(&message.data, schema, show),
            });
        }
        if let Some(from) = *titles_from_ns {
            let at = Span(Duration::from_nanos(message.log_time.saturating_sub(from)));
            let topic = &message.channel.topic;
            let repeated = if message.is_repeated() {
                ", repeated"
            } else {
                ""
            };
            match publisher {
                Some(it) => out.line(format_args!("--- {at} {topic} of {it}{repeated}"))?,
                None => out.line(format_args!("--- {at} {topic}"))?,
            }
        }
        let lines = messages::lines(&message.data, schema, show);
        out.write(|out| out.write_all(&lines))
    }
}
