//! The command line of `sm2-foxglove`.

use std::{
    error::Error,
    io::{self, IsTerminal, Write},
    net::SocketAddr,
    path::PathBuf,
    process::{self, ExitCode},
    thread,
};

use clap::{Parser, error::ErrorKind};
use signal_hook::{
    consts::{SIGINT, SIGTERM},
    iterator::Signals,
};
use sm2_node::{Node, Shutdown};
use sm2_proto::gateway::{Pattern, PatternError};

use crate::{Options, Server};

/// The status of a wrong command line, and of a wrong level of the log.
const WRONG_USAGE: u8 = 2;

/// The status of a program that a second signal ends.
const INTERRUPTED: i32 = 130;

/// Show the topics and services of a domain in Foxglove.
#[derive(Parser, Debug)]
#[command(name = "sm2-foxglove", version, after_help = HELP)]
struct Arguments {
    /// Show these topics only: names, or patterns such as camera/* and arm/** [default: all]
    #[arg(value_name = "TOPIC", value_parser = pattern)]
    topics: Vec<Pattern>,
    /// The address to listen on; port 0 chooses a free port
    #[arg(long, value_name = "ADDRESS", default_value = "127.0.0.1:8765")]
    listen: SocketAddr,
    /// Let pages of this origin connect, such as https://studio.example (may be given again)
    #[arg(long = "allow-origin", value_name = "ORIGIN")]
    allow_origins: Vec<String>,
    /// Let viewers publish
    #[arg(long)]
    allow_publish: bool,
    /// The messages that may wait for one viewer, in MiB
    #[arg(long, value_name = "MIB", default_value_t = 64, value_parser = clap::value_parser!(u32).range(1..=65_536))]
    viewer_budget_mib: u32,
    /// The processor time that the program gets: idle, what the other programs of the machine leave, or normal
    #[arg(long, value_name = "PRIORITY", value_enum, default_value_t = Priority::Idle, hide_possible_values = true)]
    priority: Priority,
    /// The name of the domain [default: $SM2_DOMAIN, or default]
    #[arg(long, value_name = "NAME", conflicts_with = "socket")]
    domain: Option<String>,
    /// The path of the Manager's socket [default: $SM2_SOCKET, or that of the domain]
    #[arg(long, value_name = "PATH")]
    socket: Option<PathBuf>,
}

/// Which processor time the program gets.
#[derive(Clone, Copy, PartialEq, Eq, Debug, clap::ValueEnum)]
enum Priority {
    /// The time that no other program of the machine wants.
    Idle,
    /// As much as each of them.
    Normal,
}

const HELP: &str = "\
The first line of output is the URL to open in Foxglove (Open connection, Foxglove WebSocket). It has a
token: every connection without it is refused, since every user and every web page of this machine can
reach a port of the loopback address. A viewer with the URL can call the services of the domain.

Pages of https://app.foxglove.dev and of servers of this machine may connect; --allow-origin adds others.
A topic has a subscriber only while a viewer looks at it. Messages are copied and sent while no other
program of the machine wants the processor; on one that is always busy, use --priority normal.

SM2_LOG (error, warn, info, debug) sets the level of the log on standard error.

Exit status: 0 ended by Ctrl-C or SIGTERM, 1 failed, 2 wrong usage.

Examples:
  sm2-foxglove
  sm2-foxglove --listen 127.0.0.1:0 scan 'camera/**'
  sm2-foxglove --domain arm --allow-publish";

/// Runs the program, and returns its exit status.
#[must_use]
pub fn main() -> ExitCode {
    let arguments = match Arguments::try_parse() {
        Ok(arguments) => arguments,
        Err(error) => return wrong_usage(&error),
    };
    let levels = match sm2_io::log_levels("warn,sm2_foxglove=info") {
        Ok(levels) => levels,
        Err(wrong) => {
            eprintln!("sm2-foxglove: {wrong}");
            return ExitCode::from(WRONG_USAGE);
        }
    };
    tracing_subscriber::fmt()
        .with_env_filter(levels)
        .with_writer(io::stderr)
        .with_ansi(io::stderr().is_terminal())
        .init();
    match run(arguments) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("sm2-foxglove: {error}");
            ExitCode::FAILURE
        }
    }
}

fn run(arguments: Arguments) -> Result<(), Box<dyn Error>> {
    if arguments.priority == Priority::Idle
        && let Err(error) = sm2_io::run_when_idle()
    {
        tracing::warn!(%error, "this program may delay others: the system refuses it the policy SCHED_IDLE");
    }
    // Viewers decide how many topics are open at a time.
    sm2_io::raise_descriptor_limit();
    let shutdown = Shutdown::new()?;
    end_with_signals(&shutdown)?;
    let path = match arguments.socket {
        Some(path) => path,
        None => sm2_io::socket_path(arguments.domain.as_deref())?,
    };
    let name = format!("sm2-foxglove-{}", process::id());
    let node = Node::builder(&name)
        .socket(path)
        .shutdown(&shutdown)
        .connect()?;
    let options = Options {
        listen: arguments.listen,
        topics: arguments.topics,
        allow_origins: arguments.allow_origins,
        allow_publish: arguments.allow_publish,
        viewer_budget_bytes: arguments.viewer_budget_mib as usize * 1024 * 1024,
    };
    let mut server = Server::start(&node, options)?;
    if !arguments.listen.ip().is_loopback() {
        eprintln!(
            "sm2-foxglove: {} can be reached from other machines, and nothing is encrypted: \
             everybody who can read the traffic can read the token",
            arguments.listen
        );
    }
    for pattern in server.unmatched() {
        let pattern = pattern.as_str();
        eprintln!(
            "sm2-foxglove: no node publishes a topic {pattern} now: it is shown when one does"
        );
    }
    let mut out = io::stdout().lock();
    writeln!(out, "{}", server.url())?;
    out.flush()?;
    drop(out);
    server.run(&shutdown)?;
    Ok(())
}

/// Requests the end of the server with SIGINT or SIGTERM. The second signal ends the program at once.
fn end_with_signals(shutdown: &Shutdown) -> io::Result<()> {
    let mut signals = Signals::new([SIGINT, SIGTERM])?;
    let shutdown = shutdown.clone();
    thread::spawn(move || {
        for _signal in signals.forever() {
            if shutdown.is_requested() {
                process::exit(INTERRUPTED);
            }
            shutdown.request();
        }
    });
    Ok(())
}

fn pattern(text: &str) -> Result<Pattern, PatternError> {
    Pattern::new(text.strip_prefix('/').unwrap_or(text))
}

/// Reports a wrong command line in one line, or prints the help that was asked for.
fn wrong_usage(error: &clap::Error) -> ExitCode {
    if matches!(
        error.kind(),
        ErrorKind::DisplayHelp | ErrorKind::DisplayVersion
    ) {
        // If standard output is closed, there is nobody to report the error to.
        let _ = error.print();
        return ExitCode::SUCCESS;
    }
    let text = error.render().to_string();
    let lines = text
        .lines()
        .map(str::trim)
        .take_while(|it| !it.starts_with("Usage:"));
    let lines: Vec<_> = lines
        .filter(|it| !it.is_empty() && !it.starts_with("For more"))
        .collect();
    let line = lines.join(" ");
    let line = line.strip_prefix("error: ").unwrap_or(&line);
    eprintln!("sm2-foxglove: {line} (see `sm2-foxglove --help`)");
    ExitCode::from(WRONG_USAGE)
}
