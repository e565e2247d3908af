//! `sm2 record`: records topics to a bag.

use std::{
    path::{Path, PathBuf},
    time::Duration,
};

use clap::Args;
use sm2_bag::{BagFile, Options, Progress, Recorder, Topics};
use sm2_io::clock;
use sm2_proto::{Instant, Name, text::Counted};

use crate::{
    args::{Domain, name, positive},
    bag_summary::show,
    compression::Compression,
    connect::Session,
    ended::Ended,
    error::CliError,
    output::Output,
    size::Size,
    time,
};

/// `sm2 record`.
#[derive(Args, Debug)]
#[command(after_help = HELP)]
pub(crate) struct Arguments {
    /// The topics, also those that have no publisher yet
    #[arg(value_name = "TOPIC", value_parser = name, required_unless_present = "all", conflicts_with = "all")]
    topics: Vec<Name>,
    /// Record all topics, also those that come later
    #[arg(long)]
    all: bool,
    /// The file to write, or the folder for a new file [default: bag-DATE-TIME.mcap, in UTC]
    #[arg(short, long, value_name = "FILE|FOLDER")]
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
    /// How often the recording is made safe against a power cut
    #[arg(long, value_name = "TIME", default_value = "100ms", value_parser = time::span)]
    sync: Duration,
    /// How messages up to 64 KiB are compressed; longer ones go to the disk as they are
    #[arg(long, value_enum, default_value_t = Compression::None)]
    compression: Compression,
    /// Print the summary at the end as one line of JSON
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    domain: Domain,
}

const HELP: &str = "\
The file is in the MCAP format, which other tools read as well. An existing file is never overwritten.

Publishers do not wait for the recorder or for its disk, except those of --reliable topics. If the disk is
too slow, up to --budget bytes of messages wait in memory; then messages are dropped. Missing messages are
counted and shown at the end, and the bag has their times and reasons.

Messages above 64 KiB go to the disk straight from the memory of their publishers, if the file system has
O_DIRECT.

After a power cut or kill -9, everything up to the last --sync interval can be read: `sm2 bag info` and
`sm2 play` use the bag as it is, and `sm2 bag recover` writes a complete one.

Exit status: 0 ended by Ctrl-C, SIGTERM or --seconds, and the bag is complete; 1 failed; 2 wrong usage.

Examples:
  sm2 record camera log --seconds 2
  sm2 record --all -o all.mcap --seconds 1
  sm2 record chatter --reliable chatter -o chat.mcap --seconds 1 --json";

/// How often the progress is shown.
const PROGRESS: Duration = Duration::from_secs(1);

/// Runs the command until a signal comes or `--seconds` has passed.
///
/// # Errors
///
/// [`CliError::Record`], [`CliError::File`], [`CliError::NotRecorded`] and the errors of connecting.
pub(crate) fn run(arguments: &Arguments) -> Result<Ended, CliError> {
    let topics = match arguments.all {
        true => Topics::All,
        false => Topics::Named(arguments.topics.iter().cloned().collect()),
    };
    let mut reliable = arguments.reliable.iter();
    if let Some(topic) = reliable.find(|it| !arguments.all && !arguments.topics.contains(it)) {
        let topic = topic.to_string();
        return Err(CliError::NotRecorded { topic });
    }
    let session = Session::open(&arguments.domain, "record")?;
    let path = path(arguments.output.as_deref());
    let file = BagFile::create(&path).map_err(|error| CliError::file("create", &path, error))?;
    let mut options = Options::new(topics);
    options.reliable = arguments.reliable.iter().cloned().collect();
    if let Some(Size(bytes)) = arguments.budget {
        options.budget_bytes = bytes;
    }
    options.sync_interval = arguments.sync;
    options.compression = arguments.compression.into();
    let failed = |source| CliError::Record {
        path: path.clone(),
        source,
    };
    let mut recorder =
        Recorder::start(&session.node, file, options, session.signal_fd()).map_err(failed)?;
    stderr_line!("recording to {} (Ctrl-C ends)", path.display());
    let recorded = record(arguments, &session, &mut recorder);
    let finished = recorder.finish();
    recorded.map_err(failed)?;
    let report = finished.map_err(failed)?;
    let mut out = Output::new();
    match arguments.json {
        true => out.json(&report)?,
        false => show(&mut out, &path, &report)?,
    }
    out.flush()?;
    Ok(Ended::Done)
}

/// Records, and shows the progress on a terminal.
fn record(
    arguments: &Arguments,
    session: &Session,
    recorder: &mut Recorder<'_>,
) -> Result<(), sm2_bag::RecordError> {
    let length = |seconds| Duration::try_from_secs_f64(seconds).unwrap_or(Duration::MAX);
    let until = match arguments.seconds {
        Some(seconds) => clock::now().after(length(seconds)),
        None => Instant(u64::MAX),
    };
    let is_shown = std::io::IsTerminal::is_terminal(&std::io::stderr());
    while session.stopped().is_none() && clock::now() < until {
        let left = until.since(clock::now()).min(PROGRESS);
        if !recorder.step(left)? {
            break;
        }
        session.is_connected();
        if is_shown {
            stderr_line!("{}", Shown(recorder.progress()));
        }
    }
    Ok(())
}

/// The path of the file: as given, in the folder that was given, or in the working directory.
fn path(output: Option<&Path>) -> PathBuf {
    // UTC.
    let now = jiff::Timestamp::now();
    let new = format!("bag-{}.mcap", now.strftime("%Y-%m-%d-%H%M%S"));
    match output {
        None => new.into(),
        Some(folder) if folder.is_dir() => folder.join(new),
        Some(file) => file.to_owned(),
    }
}

struct Shown(Progress);

impl std::fmt::Display for Shown {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let Progress {
            topics,
            messages,
            bytes,
            lost,
            waiting_bytes,
        } = self.0;
        write!(
            f,
            "{}: {} ({}), lost {lost}, {} waiting for the disk",
            Counted::new(topics as u64, "topic"),
            Counted::new(messages, "message"),
            Size(bytes),
            Size(waiting_bytes)
        )
    }
}
