use std::time::Duration;

use clap::Args;
use serde::Serialize;

use crate::{
    connect::CommandNode, ended::Ended, error::CliError, output::Output, report::Options, time,
};

/// `sm2 policy reload`.
#[derive(Args, Debug)]
#[command(after_help = HELP)]
pub(crate) struct Arguments {
    /// The time within which the policy has to be applied
    #[arg(long, value_name = "TIME", default_value = "30s", value_parser = time::span)]
    timeout: Duration,
    #[command(flatten)]
    options: Options,
}

const HELP: &str = "\
The Manager reads the file beside its socket, or the one of its option --policy, as it does on SIGHUP.
The command ends when the policy is applied: nothing is delivered any more that the policy denies. If
the file cannot be used, the policy before stays in force. Only the Manager's user and root may do this.

Exit status: 0 applied, 1 not applied, 2 wrong usage.

Examples:
  sm2 policy check policy.toml
  sm2 policy reload
  sm2 policy reload --domain arm";

/// Runs the command.
///
/// # Errors
///
/// [`CliError::Reload`], [`CliError::Output`], and those of [`CommandNode::open`].
pub(crate) fn run(arguments: &Arguments) -> Result<Ended, CliError> {
    let command_node = CommandNode::open(&arguments.options.domain, "policy")?;
    command_node.node.reload_policy(arguments.timeout)?;
    let applied = Applied { applied: true };
    Output::new().answer(arguments.options.json, &applied, |out| {
        out.line("the access policy is applied")
    })?;
    Ok(Ended::Done)
}

/// The object that `--json` prints. A policy that is not applied is an error.
#[derive(Serialize)]
struct Applied {
    applied: bool,
}
