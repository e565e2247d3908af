//! `sm2 param`: the parameters of nodes.

mod describe;
mod dump;
mod error;
mod get;
mod list;
mod load;
mod row;
mod set;
mod source;
mod watch;

use clap::Subcommand;

pub(crate) use self::{error::ParamError, source::nodes};
use crate::{ended::Ended, error::CliError};

/// The commands.
#[derive(Debug, Subcommand)]
pub(crate) enum Command {
    /// List the parameters of a node, or of all nodes
    List(list::Arguments),
    /// Print the value of a parameter
    Get(get::Arguments),
    /// Set parameters of a node: all of them or none
    Set(set::Arguments),
    /// Show the type, the range and the description of parameters
    Describe(describe::Arguments),
    /// Print the parameters of a node as a file
    Dump(dump::Arguments),
    /// Set the parameters of a node from a file: all of them or none
    Load(load::Arguments),
    /// Print the parameters of a node, and each change
    Watch(watch::Arguments),
}

/// Runs a command.
///
/// # Errors
///
/// Any [`CliError`].
pub(crate) fn run(command: &Command) -> Result<Ended, CliError> {
    match command {
        Command::List(arguments) => list::run(arguments),
        Command::Get(arguments) => get::run(arguments),
        Command::Set(arguments) => set::run(arguments),
        Command::Describe(arguments) => describe::run(arguments),
        Command::Dump(arguments) => dump::run(arguments),
        Command::Load(arguments) => load::run(arguments),
        Command::Watch(arguments) => watch::run(arguments),
    }
}
