//! `sm2 policy`: checks, explains, learns and reloads access policies.

mod check;
mod explain;
mod learn;
mod learned;
mod reload;

use clap::Subcommand;

use crate::{ended::Ended, error::CliError};

/// The commands.
#[derive(Debug, Subcommand)]
pub(crate) enum Command {
    /// Check a policy file, and warn of rules that probably do not do what they seem to
    Check(check::Arguments),
    /// Show which rule of a policy file decides about an action
    Explain(explain::Arguments),
    /// Write a policy that allows what the domain does, and nothing else
    Learn(learn::Arguments),
    /// Make the Manager read its policy again, and wait until the policy is applied
    Reload(reload::Arguments),
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
        Command::Learn(arguments) => learn::run(arguments),
        Command::Reload(arguments) => reload::run(arguments),
    }
}
