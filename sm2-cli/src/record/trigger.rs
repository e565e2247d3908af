//! `sm2 record trigger`: lets a black box keep its last seconds.

use std::time::Duration;

use clap::Args;
use serde::Serialize;
use sm2_proto::Name;

use crate::{
    args::name, connect::CommandNode, ended::Ended, error::CliError, output::Output,
    report::Options, service::ask, time,
};

/// The service of `sm2 record --last` for triggers.
pub(super) const SERVICE: &str = "record/trigger";

/// `sm2 record trigger`.
#[derive(Args, Debug)]
#[command(after_help = HELP)]
pub(crate) struct Arguments {
    /// Why; it is noted in the bag [default: the service and this command's node]
    #[arg(value_name = "REASON", default_value = "", hide_default_value = true)]
    reason: String,
    /// The service of the recorder
    #[arg(long, value_name = "NAME", value_parser = name, default_value = SERVICE)]
    service: Name,
    /// The timeout for the recorder's answer
    #[arg(long, value_name = "TIME", default_value = "5s", value_parser = time::span)]
    timeout: Duration,
    #[command(flatten)]
    options: Options,
}

const HELP: &str = "\
Prints the path of the bag that the recorder will write. The bag is complete when the time after the trigger
has passed and the recorder has reported it.

Exit status: 0 triggered; 1 no `sm2 record --last` has answered; 2 wrong usage; 130 Ctrl-C.

Examples:
  sm2 record trigger
  sm2 record trigger 'collision at the door' --timeout 10s
  sm2 record trigger --json | jq -r .bag";

/// Runs the command.
///
/// # Errors
///
/// [`CliError::NoServer`], [`CliError::Call`], and the errors of connecting.
pub(super) fn run(arguments: &Arguments) -> Result<Ended, CliError> {
    let command_node = CommandNode::open(&arguments.options.domain, "trigger")?;
    let (service, timeout) = (&arguments.service, arguments.timeout);
    let reply = ask(&command_node, service, arguments.reason.as_bytes(), timeout)?;
    let bag = String::from_utf8_lossy(&reply).into_owned();
    let triggered = Triggered { bag };
    Output::new().answer(arguments.options.json, &triggered, |out| {
        out.line(&triggered.bag)
    })?;
    Ok(Ended::Done)
}

/// The object that `--json` prints.
#[derive(Serialize)]
struct Triggered {
    /// The path of the bag.
    bag: String,
}
