//! `sm2 record`: records topics to a bag.

mod black_box;
mod common;
mod trigger;

use std::{
    fs,
    path::{Path, PathBuf},
    time::Duration,
};

use clap::{Args, Subcommand, ValueEnum};
use signal_hook::consts::SIGUSR1;
use sm2_bag::{
    BagFile, Folder, Options, RecordError, Recorder, Split, Step, Topics, create_first, numbered,
};
use sm2_io::clock;
use sm2_node::{ConnectError, Node};
use sm2_proto::{Instant, Name, text::Counted};

use self::{
    black_box::BlackBoxArguments,
    common::{SO_FAR, Shown, Unmatched, new_name, say_unmatched},
};
use crate::{
    args::{Domain, name, positive},
    bag_summary::print,
    compression::Compression,
    connect::CommandNode,
    ended::Ended,
    error::CliError,
    size::Size,
    ticker::Ticker,
    time,
    topic_patterns::{Patterns, TopicArgument, names, topics},
};

/// `sm2 record`.
#[derive(Args, Debug)]
#[command(after_help = HELP, args_conflicts_with_subcommands = true, subcommand_negates_reqs = true)]
pub(crate) struct Arguments {
    #[command(subcommand)]
    action: Option<Action>,
    /// The topics, also those that have no publisher yet, and all topics like camera/*, also those that come later
    #[arg(value_name = "TOPIC|GLOB", value_parser = topics)]
    #[arg(required_unless_present_any = ["all", "regex"], conflicts_with = "all")]
    topics: Vec<TopicArgument>,
    #[command(flatten)]
    patterns: Patterns,
    /// Record all topics, also those that come later
    #[arg(long)]
    all: bool,
    /// The file to write, or the folder for a new file [default: bag-DATE-TIME.mcap, in UTC]
    #[arg(short, long, value_name = "FILE|FOLDER", value_parser = output)]
    output: Option<PathBuf>,
    /// End after this number of seconds
    #[arg(long, value_name = "N", value_parser = positive)]
    seconds: Option<f64>,
    /// A topic whose publishers wait for the recorder; it must be among the topics (may be given again)
    #[arg(long, value_name = "TOPIC", value_parser = name)]
    reliable: Vec<Name>,
    /// How many bytes of messages may wait for the disk [default: 256MiB]
    #[arg(long, value_name = "SIZE")]
    budget: Option<Size>,
    /// Leave out and count longer messages [default: no limit, but none longer than --budget finds room]
    #[arg(long, value_name = "SIZE")]
    max_len: Option<Size>,
    /// The processor time that the recorder gets: normal, or idle, what the other programs of the machine leave
    #[arg(long, value_enum, default_value_t = Priority::Normal, hide_possible_values = true)]
    priority: Priority,
    /// How often the recording is made safe against a power cut
    #[arg(long, value_name = "TIME", default_value = "100ms", value_parser = time::span)]
    sync: Duration,
    /// How messages up to 64 KiB are compressed; longer ones go to the disk as they are
    #[arg(long, value_enum, default_value_t = Compression::None)]
    compression: Compression,
    /// Begin a new file before one becomes longer than this; the output is a folder then
    #[arg(long, value_name = "SIZE")]
    split_size: Option<Size>,
    /// Begin a new file after this time; the output is a folder then
    #[arg(long, value_name = "TIME", value_parser = time::span)]
    split_time: Option<Duration>,
    /// Remove the oldest bag-*.mcap of the output folder before all together become longer than this
    #[arg(long, value_name = "SIZE")]
    max_size: Option<Size>,
    /// End when the disk has less room than this [default: 1GiB]
    #[arg(long, value_name = "SIZE")]
    min_free: Option<Size>,
    /// End with status 0 although topics were not recorded for a time, or messages were longer than --max-len
    #[arg(long)]
    allow_missing: bool,
    #[command(flatten)]
    black_box: BlackBoxArguments,
    /// Print the summary at the end as one line of JSON
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    domain: Domain,
}

/// Which processor time the recorder gets.
#[derive(Clone, Copy, PartialEq, Eq, Debug, ValueEnum)]
enum Priority {
    /// As much as each other program.
    Normal,
    /// The time that the other programs leave.
    Idle,
}

/// The commands below `sm2 record`.
#[derive(Debug, Subcommand)]
enum Action {
    /// Let `sm2 record --last` write its last messages
    Trigger(trigger::Arguments),
}

const HELP: &str = "\
The file is in the MCAP format, which other tools read as well. An existing file is never overwritten.

Publishers do not wait for the recorder or for its disk, except those of --reliable topics. If the disk is
too slow, up to --budget bytes of messages wait in memory; then messages are dropped. Missing messages are
counted and shown at the end, and the bag has their times and reasons. With --priority idle, the recorder
delays no other program that wakes up, but it misses messages while all processors are busy.

Messages above 64 KiB go to the disk past the page cache, if the file system has O_DIRECT.

After a power cut or kill -9, everything up to the last --sync interval can be read: `sm2 bag info` and
`sm2 play` use the bag as it is, and `sm2 bag recover` writes a complete one.

With --split-size, --split-time or --max-size, the output is a folder of bags. The content of all of them is
shown at the end. If the disk has less room than --min-free, --max-size removes the oldest bags; otherwise the
recording ends, and its bag is complete.

With --last, the output is a folder (default: the working directory). The last messages are kept in the files
of a ring. Each trigger writes those before it, and those of --after, to incident-DATE-TIME.mcap. The triggers are
`sm2 record trigger`, a call of --service (a string, answered by the path of the bag), SIGUSR1, --on-message,
--on-lost and --on-deadline. After kill -9 the ring is still there: the next recorder with this ring takes it
over, and `sm2 bag merge` puts it together. Too many triggers are merged. A disk with less room than --min-free
costs messages, and incidents wait for room.

A topic is missing if it could not be recorded for a time, because descriptors were short or the Manager refused
it, or if no publisher of it was ever linked. A pattern that no topic matched is missing as well. The recorder tries
again. Missing topics are named, with the reason and the times, while it runs, at the end and in the bag.

Exit status: 0 ended by Ctrl-C, SIGTERM, SIGHUP, SIGUSR1 (without --last) or --seconds, all bags are complete, no
topic is missing and no message too long; 1 failed, the disk is full, or a topic is missing or a message too long
(0 with --allow-missing); 2 wrong usage.

Examples:
  sm2 record camera log --seconds 2
  sm2 record --all -o all.mcap --seconds 1
  sm2 record chatter --reliable chatter -o chat.mcap --seconds 1 --json
  sm2 record --all -o drives --split-size 1GB --max-size 20GB --seconds 1
  sm2 record --all --last 30s --on-lost talker --seconds 1";

/// Parses the output.
fn output(text: &str) -> Result<PathBuf, String> {
    match text {
        "-" => Err("a bag cannot be written to standard output: name a file (./- is one)".into()),
        path => Ok(path.into()),
    }
}

/// The names of new bags begin with this.
const BAG: &str = "bag";
/// A folder with a limit has at least this number of files.
const RING_FILES: u64 = 8;
/// Runs the command until a signal comes or `--seconds` has passed.
///
/// # Errors
///
/// [`CliError::Record`], [`CliError::File`], [`CliError::NotRecorded`] and the errors of connecting.
pub(crate) fn run(arguments: &Arguments) -> Result<Ended, CliError> {
    if let Some(Action::Trigger(arguments)) = &arguments.action {
        return trigger::run(arguments);
    }
    // Threads that start later inherit the policy.
    if arguments.priority == Priority::Idle
        && let Err(error) = sm2_io::run_when_idle()
    {
        stderr_line!(
            "sm2: the recorder may delay others: the system refuses it the policy SCHED_IDLE ({error})"
        );
    }
    let options = arguments.options();
    if let Some(topic) = (arguments.reliable.iter()).find(|it| !options.topics.choose(it)) {
        let topic = topic.to_string();
        return Err(CliError::NotRecorded { topic });
    }
    let command_node = CommandNode::open(&arguments.domain, "record")?;
    let length = |seconds| Duration::try_from_secs_f64(seconds).unwrap_or(Duration::MAX);
    let until = match arguments.seconds {
        Some(seconds) => clock::now().after(length(seconds)),
        None => Instant(u64::MAX),
    };
    let (domain, socket) = (&arguments.domain, arguments.domain.path()?);
    let connect = move || domain.connect_further(&socket, "record");
    let is_missing = match arguments.black_box.last {
        Some(last) => {
            let output = arguments.output.as_deref().unwrap_or(Path::new("."));
            let (output, end) = ((output, options), (until, arguments.json));
            black_box::run(
                &arguments.black_box,
                last,
                output,
                end,
                &command_node,
                connect,
            )?
        }
        None => record_bag(arguments, options, until, &command_node, connect)?,
    };
    Ok(Ended::with_answer(!is_missing || arguments.allow_missing))
}

/// Records to a file or a folder until a signal comes or the time `until`. Returns whether a topic was missing, or a
/// message too long.
fn record_bag<'a>(
    arguments: &Arguments,
    options: Options,
    until: Instant,
    command_node: &'a CommandNode,
    connect: impl FnMut() -> Result<Node, ConnectError> + Send + 'a,
) -> Result<bool, CliError> {
    // It triggers a black box. Without one, it must not end the recording without a summary.
    command_node.end_on(SIGUSR1)?;
    let stop = command_node.signal_fd();
    let split = arguments.split();
    let is_one_file = split.is_none();
    let (path, folder, started) = match split {
        None => {
            let (path, file) = create(arguments.output.as_deref())?;
            let folder = Folder::of_file(&path, file);
            let split = Split::default();
            let started =
                Recorder::start_in(&command_node.node, folder.clone(), split, options, stop);
            (path, folder, started)
        }
        Some(split) => {
            let (path, folder) = arguments.folder()?;
            let started =
                Recorder::start_in(&command_node.node, folder.clone(), split, options, stop);
            (path, folder, started)
        }
    };
    let failed = |source| CliError::Record {
        path: path.clone(),
        source,
    };
    let mut recorder = started.map_err(failed)?;
    recorder.connect_with(connect);
    stderr_line!("recording to {} (Ctrl-C ends)", path.display());
    let recorded = record(until, command_node, &mut recorder);
    say_unmatched(&recorder.unmatched(), recorder.domain(), "was there");
    let finished = recorder.finish();
    if let (true, (further @ 2.., _)) = (is_one_file, folder.counts()) {
        let further = Counted::new(u64::from(further) - 1, "more file");
        stderr_line!("sm2: there were too many publishers for one file: {further} beside it");
    }
    // A recording that ended early has its summary as well.
    if let Ok(report) = &finished {
        print(&path, report, arguments.json)?;
    }
    recorded.map_err(failed)?;
    let report = finished.map_err(failed)?;
    Ok(report.not_recorded > 0 || report.too_long() > 0)
}

impl Arguments {
    fn options(&self) -> Options {
        let mut patterns = self.patterns.with(&self.topics);
        if self.all {
            patterns.include.clear();
        }
        let excluded = |it: &&Name| patterns.exclude.iter().any(|one| one.matches(it.as_str()));
        let named = names(&self.topics).filter(|it| !excluded(it)).cloned();
        let topics = match self.all || !patterns.include.is_empty() {
            true => Topics::Matching(named.collect(), patterns),
            false => Topics::Named(named.collect()),
        };
        let defaults = Options::new(topics);
        Options {
            reliable: self.reliable.iter().cloned().collect(),
            budget_bytes: self.budget.map_or(defaults.budget_bytes, |it| it.0),
            max_len_bytes: self.max_len.map_or(defaults.max_len_bytes, |it| it.0),
            sync_interval: self.sync,
            compression: self.compression.into(),
            min_free_bytes: self.min_free.map_or(defaults.min_free_bytes, |it| it.0),
            ..defaults
        }
    }

    /// When a new file begins; `None` if there is one file only.
    fn split(&self) -> Option<Split> {
        let is_split = self.split_size.or(self.max_size).is_some() || self.split_time.is_some();
        let ring = self.max_size.map(|it| it.0 / RING_FILES);
        let size = self.split_size.map(|it| it.0);
        is_split.then_some(Split {
            // A ring removes whole files.
            bytes: size.into_iter().chain(ring).min(),
            time: self.split_time,
        })
    }

    /// The folder for the files.
    fn folder(&self) -> Result<(PathBuf, Folder), CliError> {
        let path = match &self.output {
            Some(path) => path.clone(),
            None => {
                let stem = new_name("bags");
                let (path, created) =
                    create_first(|it| numbered(&stem, it).into(), |it| fs::create_dir(it));
                created.map_err(|error| CliError::file("create", &path, error))?;
                path
            }
        };
        let failed = |error| CliError::file("use the folder", &path, error);
        let folder = Folder::new(&path, &new_name(BAG)).map_err(failed)?;
        let folder = match self.max_size {
            Some(Size(limit)) => folder
                .keep_bytes(limit, &format!("{BAG}-"))
                .map_err(failed)?,
            None => folder,
        };
        Ok((path, folder))
    }
}

/// Records, and shows the progress on a terminal.
fn record(
    until: Instant,
    command_node: &CommandNode,
    recorder: &mut Recorder<'_>,
) -> Result<(), RecordError> {
    let (mut ticker, mut unmatched) = (Ticker::new(), Unmatched::new());
    while command_node.stopped().is_none() && clock::now() < until {
        match recorder.step(unmatched.left(ticker.left(until)))? {
            Step::Timeout | Step::Woken => {}
            Step::Stopped => break,
            Step::DiskFull => return Err(RecordError::DiskFull),
        }
        command_node.is_connected();
        ticker.tick(|| Shown(recorder.progress()));
        if unmatched.is_due() {
            say_unmatched(&recorder.unmatched(), recorder.domain(), SO_FAR);
        }
    }
    Ok(())
}

/// Creates the file: as given, in the folder that was given, or in the working directory.
fn create(output: Option<&Path>) -> Result<(PathBuf, BagFile), CliError> {
    let in_folder = |folder: &Path| {
        let stem = new_name(BAG);
        let path = |number| folder.join(format!("{}.mcap", numbered(&stem, number)));
        create_first(path, BagFile::create)
    };
    let (path, created) = match output {
        None => in_folder(Path::new("")),
        Some(folder) if folder.is_dir() => in_folder(folder),
        Some(file) => (file.to_owned(), BagFile::create(file)),
    };
    match created {
        Ok(file) => Ok((path, file)),
        Err(error) => Err(CliError::file("create", &path, error)),
    }
}

#[cfg(test)]
mod tests;
