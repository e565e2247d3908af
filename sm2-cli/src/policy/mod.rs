//! `sm2 policy`: checks access policies, and explains their decisions. Needs no Manager.

mod check;
mod explain;

use clap::Subcommand;

use crate::{ended::Ended, error::CliError};

/// The commands.
#[derive(Debug, Subcommand)]
pub(crate) enum Command {
    /// Check a policy file, and warn of rules that probably do not do what they seem to
    Check(check::Arguments),
    /// Show which rule of a policy file decides about an action
    Explain(explain::Arguments),
}

/// Runs a command.
///
/// # Errors
///
/// Any [`CliError`].
pub(crate) fn run(command: &Command) -> Result<Ended, CliError> {
    match command {
        Command::Check(arguments) => check::run(arguments),
        Command::Explain(arguments) => explain::run(arguments),
    }
}
