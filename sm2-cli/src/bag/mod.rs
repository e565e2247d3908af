//! `sm2 bag`: shows, checks, recovers, copies, corrects and compares recordings.

mod cat;
mod check;
mod copy;
mod diff;
mod info;
mod list;
mod recover;
mod restamp;
mod work;

use clap::Subcommand;

use crate::{ended::Ended, error::CliError};

/// The commands.
#[derive(Debug, Subcommand)]
pub(crate) enum Command {
    /// List the bags of a folder
    Ls(list::Arguments),
    /// Show the topics, the times and the gaps of a bag
    Info(info::Arguments),
    /// Print messages of a bag
    Cat(cat::Arguments),
    /// Read a bag completely, and verify its checksums and its summary
    Check(check::Arguments),
    /// Write what can be read of a damaged bag to a new one
    Recover(recover::Arguments),
    /// Copy chosen topics and times of a bag to a new one
    Filter(copy::FilterArguments),
    /// Copy a bag to a new one with another compression
    Convert(copy::ConvertArguments),
    /// Copy several bags to a new one, in the order of their times
    Merge(copy::MergeArguments),
    /// Correct the times of a recording during which the wall clock was corrected
    Restamp(restamp::Arguments),
    /// Find the first difference between the payloads of two bags
    Diff(diff::Arguments),
}

/// Runs a command.
///
/// # Errors
///
/// Any [`CliError`].
pub(crate) fn run(command: &Command) -> Result<Ended, CliError> {
    match command {
        Command::Ls(arguments) => list::run(arguments),
        Command::Info(arguments) => info::run(arguments),
        Command::Cat(arguments) => cat::run(arguments),
        Command::Check(arguments) => check::run(arguments),
        Command::Recover(arguments) => recover::run(arguments),
        Command::Filter(arguments) => copy::filter(arguments),
        Command::Convert(arguments) => copy::convert(arguments),
        Command::Merge(arguments) => copy::merge(arguments),
        Command::Restamp(arguments) => restamp::run(arguments),
        Command::Diff(arguments) => diff::run(arguments),
    }
}
