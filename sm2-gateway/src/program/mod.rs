//! The command line of gateways: `sm2-gateway` and `sm2 gateway`.
//!
//! | exit status | |
//! | --- | --- |
//! | 0 | success; `run`: stopped by SIGINT or SIGTERM |
//! | 1 | an error, described on standard error, or the answer no |
//! | 2 | wrong usage |

mod ask;
mod check;
mod error;
mod explain;
mod keys;
mod options;
mod output;
mod peers;
mod run;
mod trust;

use std::{
    io::{self, IsTerminal, Write},
    process::ExitCode,
};

use clap::Subcommand;
use tracing_subscriber::{
    filter::Targets, layer::SubscriberExt as _, util::SubscriberInitExt as _,
};

pub use self::{error::ProgramError, options::Domain};

/// The end of the help. `command` is the name of the program: `sm2-gateway` or `sm2 gateway`.
#[must_use]
pub fn examples(command: &str) -> String {
    format!(
        "\
The key file identifies a gateway: peers trust its public key, the id. A gateway carries only what the
rules of both sides allow.
SM2_LOG (error, warn, info, debug) sets the level of the log of `run` on standard error. On SIGHUP, `run`
reads its configuration again; a bad configuration is logged and changes nothing.

Examples:
  {command} keygen robot.key
  {command} id robot.key
  {command} trust robot.toml base 3f…e1 192.0.2.1:7633
  {command} check robot.toml
  {command} explain camera/front --config robot.toml --peer base --direction out
  {command} run robot.toml
  {command} ask camera/front --peer robot
  {command} peers --json"
    )
}

/// A command.
#[derive(Debug, Subcommand)]
pub enum Command {
    /// Carry topics and services between this domain and those of peers
    #[command(after_help = RUN)]
    Run(run::Arguments),
    /// Make a key, in a file that only its owner can read
    #[command(after_help = KEYGEN)]
    Keygen(keys::Arguments),
    /// Print the id that belongs to a key, for peers to trust
    #[command(after_help = ID)]
    Id(keys::Arguments),
    /// Add a peer to a configuration
    #[command(after_help = TRUST)]
    Trust(trust::Arguments),
    /// Show the peers of the gateways of a domain, with counts of messages
    #[command(after_help = PEERS)]
    Peers(peers::Arguments),
    /// Ask a peer whether it offers a topic or service to this domain
    #[command(after_help = ASK)]
    Ask(ask::Arguments),
    /// Show which rule decides about a name
    #[command(after_help = EXPLAIN)]
    Explain(explain::Arguments),
    /// Check a configuration, and list what it would carry now
    #[command(after_help = CHECK)]
    Check(check::Arguments),
}

const RUN: &str = "\
Examples:
  sm2 gateway run robot.toml
  sm2 gateway run robot.toml --metrics 127.0.0.1:9633
  sm2 gateway run robot.toml --shadow stricter.toml";
const KEYGEN: &str = "\
Examples:
  sm2 gateway keygen robot.key";
const ID: &str = "\
Examples:
  sm2 gateway id robot.key";
const TRUST: &str = "\
Examples:
  sm2 gateway trust robot.toml base 3f…e1 192.0.2.1:7633";
const PEERS: &str = "\
Examples:
  sm2 gateway peers
  sm2 gateway peers --json | jq '.peers[].messages'";
const ASK: &str = "\
Examples:
  sm2 gateway ask camera/front --peer robot
  sm2 gateway ask map/save --kind service --peer robot";
const EXPLAIN: &str = "\
Examples:
  sm2 gateway explain camera/front --config robot.toml --peer base --direction out";
const CHECK: &str = "\
Examples:
  sm2 gateway check robot.toml
  sm2 gateway check robot.toml --shadow stricter.toml";

/// Executes a command. False if the answer is no.
///
/// # Errors
/// See [`ProgramError`].
pub fn execute(command: &Command, out: &mut impl Write) -> Result<bool, ProgramError> {
    match command {
        Command::Run(arguments) => run::run(arguments).map(|()| true),
        Command::Keygen(arguments) => keys::generate(arguments, out).map(|()| true),
        Command::Id(arguments) => keys::id(arguments, out).map(|()| true),
        Command::Trust(arguments) => trust::run(arguments).map(|()| true),
        Command::Peers(arguments) => peers::run(arguments, out).map(|()| true),
        Command::Ask(arguments) => ask::run(arguments, out),
        Command::Explain(arguments) => explain::run(arguments, out),
        Command::Check(arguments) => check::run(arguments, out).map(|()| true),
    }
}

/// [`execute`] with logs and errors on standard error, and an exit status. `program` is the name of the
/// program.
#[must_use]
pub fn main(command: &Command, program: &str) -> ExitCode {
    let default = match command {
        Command::Run(_) => "info",
        _ => "error",
    };
    let levels = match sm2_io::log_levels(default) {
        Ok(levels) => levels,
        Err(wrong) => {
            let _ = writeln!(io::stderr(), "{program}: {wrong}");
            return ExitCode::from(2);
        }
    };
    let logs = tracing_subscriber::fmt::layer()
        .with_ansi(io::stderr().is_terminal())
        .with_writer(io::stderr);
    let filter: Targets = levels.parse().expect("`log_levels` has checked them");
    // Fails if the program has installed a subscriber of its own, which then stays.
    let _ = tracing_subscriber::registry()
        .with(filter)
        .with(logs)
        .try_init();
    match execute(command, &mut io::stdout().lock()) {
        Ok(true) => ExitCode::SUCCESS,
        Ok(false) => ExitCode::FAILURE,
        Err(ProgramError::System { source, .. }) if source.kind() == io::ErrorKind::BrokenPipe => {
            ExitCode::SUCCESS
        }
        Err(error) => {
            // Standard error may be closed.
            let _ = writeln!(io::stderr(), "{program}: {error}");
            ExitCode::FAILURE
        }
    }
}
