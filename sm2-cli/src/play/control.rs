//! `sm2 play control`: pauses, steps and speeds up `sm2 play`.

use std::{fmt, time::Duration};

use clap::{Args, ValueEnum};
use sm2_bag::{PlayCommand, PlayStatus};
use sm2_proto::{Name, text::Counted};

use crate::{
    args::{Domain, name, rate},
    connect::CommandNode,
    ended::Ended,
    error::CliError,
    output::Output,
    service::ask,
    time,
};

/// The service of `sm2 play` for commands.
pub(super) const SERVICE: &str = "play/control";

/// `sm2 play control`.
#[derive(Args, Debug)]
#[command(after_help = HELP)]
pub(crate) struct Arguments {
    /// The command
    #[arg(value_name = "COMMAND", value_enum)]
    action: Action,
    /// The speed of `rate`: 1 as recorded, 2 twice as fast, 0 as fast as possible
    #[arg(value_name = "FACTOR", value_parser = rate, required_if_eq("action", "rate"))]
    factor: Option<f64>,
    /// The service of the player
    #[arg(long, value_name = "NAME", value_parser = name, default_value = SERVICE)]
    service: Name,
    /// The timeout for the player's answer
    #[arg(long, value_name = "TIME", default_value = "5s", value_parser = time::span)]
    timeout: Duration,
    /// Print the state of the player as one line of JSON
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    domain: Domain,
}

/// The commands for a player.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum Action {
    /// Publish nothing, and let domain time stand still
    Pause,
    /// Go on after a pause
    Resume,
    /// Publish the next message of a pause; in lockstep, those of the next time
    Step,
    /// Change the speed, now or for the end of a pause
    Rate,
}

const HELP: &str = "\
Prints the state of the player when it has followed the command: whether it is paused, the time of the last
message, the rate, and the number of messages so far.

Exit status: 0 the player has followed; 1 no `sm2 play` has answered, or it has refused a step without a
pause; 2 wrong usage; 130 Ctrl-C.

Examples:
  sm2 play control pause
  sm2 play control rate 0.5 --json";

/// Runs the command.
///
/// # Errors
///
/// [`CliError::NoServer`], [`CliError::Call`], [`CliError::NotForRate`], and the errors of connecting.
pub(super) fn run(arguments: &Arguments) -> Result<Ended, CliError> {
    let command = arguments.command()?.to_string();
    let command_node = CommandNode::open(&arguments.domain, "control")?;
    let (service, timeout) = (&arguments.service, arguments.timeout);
    let reply = ask(&command_node, service, command.as_bytes(), timeout)?;
    let reply = String::from_utf8_lossy(&reply);
    let mut out = Output::new();
    match serde_json::from_str::<PlayStatus>(&reply) {
        Ok(status) if !arguments.json => out.line(Shown(status))?,
        // Also the answer of a program that is not a player.
        _ => out.line(reply)?,
    }
    Ok(Ended::Done)
}

impl Arguments {
    fn command(&self) -> Result<PlayCommand, CliError> {
        match (self.action, self.factor) {
            (Action::Pause, None) => Ok(PlayCommand::Pause),
            (Action::Resume, None) => Ok(PlayCommand::Resume),
            (Action::Step, None) => Ok(PlayCommand::Step),
            (Action::Rate, Some(rate)) => Ok(PlayCommand::Rate(rate)),
            _ => Err(CliError::NotForRate),
        }
    }
}

/// `paused at 2026-11-27T09:30:01.25Z, rate 2, 7 messages`
pub(super) struct Shown(pub(super) PlayStatus);

impl fmt::Display for Shown {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let PlayStatus {
            paused,
            rate,
            messages,
            time_ns,
        } = self.0;
        f.write_str(if paused { "paused" } else { "playing" })?;
        let time = time_ns.and_then(|it| jiff::Timestamp::from_nanosecond(it.into()).ok());
        if let Some(time) = time {
            write!(f, " at {time}")?;
        }
        write!(f, ", rate {rate}, {}", Counted::new(messages, "message"))
    }
}
