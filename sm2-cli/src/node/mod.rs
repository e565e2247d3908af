//! `sm2 node`: lists nodes, and shows one of them.

mod info;
mod list;

use clap::Subcommand;

use crate::{ended::Ended, error::CliError, report::Options};

/// The commands.
#[derive(Debug, Subcommand)]
pub(crate) enum Command {
    /// List the nodes of a domain
    #[command(after_help = list::HELP)]
    List(Options),
    /// Show a node: its process, its interfaces, its links
    Info(info::Arguments),
}

/// Runs a command.
///
/// # Errors
///
/// Any [`CliError`].
pub(crate) fn run(command: &Command) -> Result<Ended, CliError> {
    match command {
        Command::List(options) => list::run(options),
        Command::Info(arguments) => info::run(arguments),
    }
}
