//! The command line: which commands there are, and what several of them share.

use std::{path::PathBuf, time::Duration};

use clap::{Args, Parser, Subcommand, ValueEnum};
use sm2_proto::{Name, NameError};

use crate::{
    completions, demo, doctor, manual, node, service, snapshot, time, top, topic, wait_for, why,
};

/// What every page of help about names says.
pub(crate) const GRAMMAR: &str =
    "segments of A-Z a-z 0-9 _ - joined by single /, at most 255 bytes";

/// Look into an SM2 domain, feed it, and run it, from a shell.
#[derive(Debug, Parser)]
#[command(name = "sm2", version, after_help = EXAMPLES)]
pub(crate) struct Cli {
    #[command(subcommand)]
    pub(crate) command: Command,
}

/// The commands, each in a module of its own.
#[derive(Debug, Subcommand)]
pub(crate) enum Command {
    /// Serve a domain: the broker that every node of it needs
    #[command(after_help = sm2_manager::program::examples("sm2 manager"))]
    Manager(sm2_manager::program::Arguments),
    /// Publish, print, list and measure topics
    #[command(subcommand, after_help = TOPIC_EXAMPLES)]
    Topic(topic::Command),
    /// List and call services
    #[command(subcommand, after_help = SERVICE_EXAMPLES)]
    Service(service::Command),
    /// List nodes, and show what one does
    #[command(subcommand, after_help = NODE_EXAMPLES)]
    Node(node::Command),
    /// Show the whole domain at one moment, or its changes
    Snapshot(snapshot::Arguments),
    /// Wait until something is true of topics, services and nodes
    Wait(wait_for::Arguments),
    /// Say why two interfaces are linked, or why they are not
    Why(why::Arguments),
    /// Watch rates and losses of a domain, live
    Top(top::Arguments),
    /// Check this machine, the Manager and the domain
    Doctor(doctor::Arguments),
    /// Carry topics and services to other domains and machines
    #[command(subcommand, after_help = sm2_gateway::program::examples("sm2 gateway"))]
    Gateway(sm2_gateway::program::Command),
    /// Show what large messages cost on this machine; needs no Manager
    Demo(demo::Arguments),
    /// Print a shell's completions of this command
    Completions(completions::Arguments),
    /// Print a manual page of this command, or write all of them
    Man(manual::Arguments),
    /// One process of the demo: [`sm2_demo::COMMAND`], which is no word for people.
    #[command(skip)]
    DemoPart(sm2_demo::ProcessArguments),
}

const EXAMPLES: &str = "\
Exit status: 0 done, 1 failed or not true, 2 wrong usage, 130 or 143 stopped by Ctrl-C or
SIGTERM before it was done. A second Ctrl-C ends a command at once.

Environment: SM2_SOCKET, SM2_DOMAIN and XDG_RUNTIME_DIR say where the Manager is;
SM2_LOG (error, warn, info, debug) what is logged on standard error.

When the Manager ends, commands that go on (echo, pub, hz, bw, delay, loss, top, wait,
snapshot --watch) say so on standard error and wait for its successor; links go on meanwhile.

The commands' own nodes are named sm2-COMMAND-PID; lists leave out the command that prints them.

Examples:
  sm2 manager                              serve the default domain
  echo hello | sm2 topic pub chatter --from -
  sm2 topic echo chatter                   print what is published
  sm2 topic hz chatter                     how often, without subscribing
  sm2 topic list --json                    what there is, for a program
  sm2 wait 'topic:/scan publishers>=1' --timeout 5s
  sm2 why talker listener                  why they are linked, or not
  sm2 doctor                               what is wrong here
  sm2 demo --seconds 5 --integrity sealed  5 subscribers, 10 MB, 30 Hz";

const TOPIC_EXAMPLES: &str = "\
hz, bw, delay and loss read what nodes count anyway; they subscribe to nothing.

Examples:
  sm2 topic list
  sm2 topic info scan
  sm2 topic echo scan --count 1
  sm2 topic hz scan";

const SERVICE_EXAMPLES: &str = "\
Examples:
  sm2 service list
  sm2 service info sum
  sm2 service call sum '[1, 2, 3]'";

const NODE_EXAMPLES: &str = "\
Examples:
  sm2 node list
  sm2 node info talker";

/// Which domain a command talks to, and how long it tries.
#[derive(Args, Clone, Debug)]
#[command(next_help_heading = "Domain")]
pub(crate) struct Domain {
    /// The domain to talk to [default: $SM2_DOMAIN, else `default`]
    #[arg(long, value_name = "NAME")]
    pub(crate) domain: Option<String>,
    /// Its Manager's socket, wherever it is [default: $SM2_SOCKET, else the domain's]
    #[arg(long, value_name = "PATH", conflicts_with = "domain")]
    pub(crate) socket: Option<PathBuf>,
    /// How long the Manager may take to answer, such as 500ms
    #[arg(long, value_name = "TIME", default_value = "5s", value_parser = time::span)]
    pub(crate) connect_timeout: Duration,
    /// Wait so long for a Manager that is not there yet, such as 30s
    #[arg(long, value_name = "TIME", value_parser = time::span)]
    pub(crate) wait_manager: Option<Duration>,
}

/// How messages too large for a datagram are shared.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub(crate) enum Integrity {
    // Not documentation, which would make help a page long.
    // In memory that is used again.
    Pooled,
    // Each in memory of its own that nobody can change any more, its author neither.
    Sealed,
}

/// Reads a name as a person types it: one leading `/` is dropped.
pub(crate) fn name(text: &str) -> Result<Name, String> {
    Name::typed(text).map_err(|error| {
        let fault = match error {
            NameError::Empty => "it is empty".to_owned(),
            NameError::TooLong(len) => format!("it has {len} bytes"),
            NameError::EmptySegment(at) => format!("a segment is empty at byte {at}"),
            NameError::BadByte(at) => format!("byte {at} is none of these"),
        };
        format!("a name is {GRAMMAR}; {fault}")
    })
}

/// Reads a positive number that is not infinite.
pub(crate) fn positive(text: &str) -> Result<f64, String> {
    match text.parse::<f64>() {
        Ok(value) if value.is_finite() && value > 0.0 => Ok(value),
        _ => Err("give a number above 0, such as 30 or 0.5".into()),
    }
}
