//! `gateway`: the gateway as the `sm2 gateway run` command runs it.

use std::process::ExitCode;

use clap::Parser;
use sm2_gateway::program::{self, Command};

use crate::{input::abort_at_end, options::Options};

#[derive(Parser)]
struct Arguments {
    #[command(subcommand)]
    command: Command,
}

/// Runs a gateway with the configuration `--config`, until its standard input ends.
#[must_use]
pub fn run(options: &Options) -> ExitCode {
    abort_at_end();
    let config: String = options.get("--config").expect("--config");
    let arguments = Arguments::parse_from(["gateway", "run", &config]);
    program::main(&arguments.command, "gateway")
}
