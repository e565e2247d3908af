//! The command line of the demo's own processes: the demo starts its program again with it.

use std::path::PathBuf;

use clap::{Parser, ValueEnum};

/// The first word of the command line that the demo starts its processes with.
pub const COMMAND: &str = "demo-part";

/// The words that follow [`COMMAND`].
#[derive(Clone, Debug, Parser)]
#[command(name = COMMAND)]
pub struct ProcessArguments {
    #[arg(value_enum)]
    pub(crate) role: Role,
    /// The node's name.
    #[arg(long)]
    pub(crate) name: String,
    /// The socket of the demo's Manager.
    #[arg(long)]
    pub(crate) socket: PathBuf,
    /// The length of a message in bytes.
    #[arg(long)]
    pub(crate) size: u64,
    /// The time between two messages in nanoseconds.
    #[arg(long)]
    pub(crate) period: u64,
    /// The number of messages.
    #[arg(long)]
    pub(crate) count: u64,
    /// The number of subscribers.
    #[arg(long)]
    pub(crate) subscribers: u32,
    /// Seal each message.
    #[arg(long)]
    pub(crate) sealed: bool,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub(crate) enum Role {
    Publisher,
    Subscriber,
}
