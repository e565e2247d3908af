//! `sm2 service`: lists, shows and calls services.

mod call;
mod info;
mod list;

use clap::Subcommand;

pub(crate) use self::call::ask;
use crate::{ended::Ended, error::CliError, report::Options};

/// The commands.
#[derive(Debug, Subcommand)]
pub(crate) enum Command {
    /// List the services of a domain
    #[command(after_help = list::HELP)]
    List(Options),
    /// Show a service: its types, its servers and clients
    Info(info::Arguments),
    /// Call a service and print the reply
    Call(Box<call::Arguments>),
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
        Command::Call(arguments) => call::run(arguments),
    }
}
