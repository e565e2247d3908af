//! `sm2 topic`: publish, print, list and measure topics.

mod bw;
mod delay;
mod echo;
mod folder;
mod hz;
mod info;
mod list;
mod loss;
mod measure;
mod publish;
mod source;
mod wait_hint;

use clap::Subcommand;

pub(crate) use self::loss::Fates;
use crate::{ended::Ended, error::CliError};

/// The commands.
#[derive(Debug, Subcommand)]
pub(crate) enum Command {
    /// List the topics of a domain
    List(list::Arguments),
    /// Show a topic: its type, its publishers and subscribers
    Info(info::Arguments),
    /// Publish files, standard input, or a value
    Pub(Box<publish::Arguments>),
    /// Print the messages of a topic, or write them to files
    Echo(echo::Arguments),
    /// Measure the rate of messages
    Hz(hz::Arguments),
    /// Measure the bandwidth of messages
    Bw(bw::Arguments),
    /// Measure the delays of messages from publishing to receiving
    Delay(delay::Arguments),
    /// Show the fates of messages, for each link
    Loss(loss::Arguments),
}

/// Runs a command.
///
/// # Errors
///
/// Any [`CliError`].
pub(crate) fn run(command: &Command) -> Result<Ended, CliError> {
    match command {
        Command::List(arguments) => list::run(arguments),
        Command::Info(arguments) => info::run(arguments),
        Command::Pub(arguments) => publish::run(arguments),
        Command::Echo(arguments) => echo::run(arguments),
        Command::Hz(arguments) => hz::run(arguments),
        Command::Bw(arguments) => bw::run(arguments),
        Command::Delay(arguments) => delay::run(arguments),
        Command::Loss(arguments) => loss::run(arguments),
    }
}
