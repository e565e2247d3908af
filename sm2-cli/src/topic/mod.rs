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
use crate::{ended::Ended, error::CliError, report::Options};

/// The commands.
#[derive(Debug, Subcommand)]
pub(crate) enum Command {
    /// List the topics of a domain
    #[command(after_help = list::HELP)]
    List(Options),
    /// Show a topic: its type, its publishers and subscribers
    Info(info::Arguments),
    /// Publish files, standard input, or a value
    Pub(Box<publish::Arguments>),
    /// Print the messages of a topic, or write them to files
    Echo(echo::Arguments),
    /// Measure the rate of messages
    #[command(after_help = hz::HELP)]
    Hz(measure::Arguments),
    /// Measure the bandwidth of messages
    #[command(after_help = bw::HELP)]
    Bw(measure::Arguments),
    /// Measure the delays of messages from publishing to receiving
    #[command(after_help = delay::HELP)]
    Delay(measure::Arguments),
    /// Show the fates of messages, for each link
    #[command(after_help = loss::HELP)]
    Loss(measure::Arguments),
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
        Command::Pub(arguments) => publish::run(arguments),
        Command::Echo(arguments) => echo::run(arguments),
        Command::Hz(arguments) => measure::run::<hz::Row>(arguments),
        Command::Bw(arguments) => measure::run::<bw::Row>(arguments),
        Command::Delay(arguments) => measure::run::<delay::Row>(arguments),
        Command::Loss(arguments) => measure::run::<loss::Row>(arguments),
    }
}
