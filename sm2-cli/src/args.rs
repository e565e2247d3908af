//! The command line: which commands there are, and what several of them share.

use std::path::PathBuf;

use clap::{Args, Parser, Subcommand, ValueEnum};
use sm2_proto::Name;

use crate::{demo, node, topic};

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
    #[command(after_help = MANAGER_EXAMPLES)]
    Manager(sm2_manager::program::Arguments),
    /// Publish, print and list topics
    #[command(subcommand)]
    Topic(topic::Command),
    /// List nodes
    #[command(subcommand)]
    Node(node::Command),
    /// Show what large messages cost on this machine; needs no Manager
    Demo(demo::Arguments),
    /// One process of the demo
    #[command(hide = true)]
    DemoPart(demo::PartArguments),
}

const EXAMPLES: &str = "\
Examples:
  sm2 manager                              serve the default domain
  echo hello | sm2 topic pub chatter --from -
  sm2 topic echo chatter                   print what is published
  sm2 topic list --json                    what there is, for a program
  sm2 demo --seconds 5 --integrity sealed  5 subscribers, 10 MB, 30 Hz

Exit status: 0 done, 1 failed, 2 wrong usage, 130 or 143 stopped by Ctrl-C or
SIGTERM before it was done.

Environment: SM2_SOCKET, SM2_DOMAIN and XDG_RUNTIME_DIR say where the Manager is;
SM2_LOG (error, warn, info, debug) what is logged on standard error.";

const MANAGER_EXAMPLES: &str = "\
It serves until Ctrl-C or SIGTERM. SM2_LOG (error, warn, info, debug) says what it logs on standard error.

Examples:
  sm2 manager
  sm2 manager --domain arm --seal-all
  sm2 manager --socket /run/robot/sm2.sock --socket-mode 660";

/// Which domain a command talks to.
#[derive(Args, Clone, Debug, Default)]
pub(crate) struct Domain {
    /// The domain to talk to [default: $SM2_DOMAIN, else `default`]
    #[arg(long, value_name = "NAME")]
    pub(crate) domain: Option<String>,
    /// Its Manager's socket, wherever it is [default: $SM2_SOCKET, else the domain's]
    #[arg(long, value_name = "PATH", conflicts_with = "domain")]
    pub(crate) socket: Option<PathBuf>,
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

impl Integrity {
    pub(crate) const fn as_str(self) -> &'static str {
        match self {
            Self::Pooled => "pooled",
            Self::Sealed => "sealed",
        }
    }
}

/// Reads a name as a person types it: one leading `/` is dropped.
pub(crate) fn name(text: &str) -> Result<Name, String> {
    Name::typed(text).map_err(|error| format!("{error}; a name is {GRAMMAR}"))
}

/// Reads a positive number that is not infinite.
pub(crate) fn positive(text: &str) -> Result<f64, String> {
    match text.parse::<f64>() {
        Ok(value) if value.is_finite() && value > 0.0 => Ok(value),
        _ => Err("give a number above 0, such as 30 or 0.5".into()),
    }
}
