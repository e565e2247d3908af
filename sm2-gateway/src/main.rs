//! The gateway as a separate program. `sm2 gateway` runs the same code.
#![forbid(unsafe_code)]

use std::process::ExitCode;

use clap::Parser;
use sm2_gateway::program::{self, Command};

/// Carry topics and services between SM2 domains
#[derive(Parser)]
#[command(version, after_help = program::examples("sm2-gateway"))]
struct Cli {
    #[command(subcommand)]
    command: Command,
}

fn main() -> ExitCode {
    program::main(&Cli::parse().command, "sm2-gateway")
}
