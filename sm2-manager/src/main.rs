//! The `sm2-manager` program. `sm2 manager` runs the same code.

use std::process::ExitCode;

use clap::Parser;
use sm2_manager::program::{Arguments, examples, main as serve};

/// The broker of an SM2 domain
#[derive(Parser)]
#[command(version, after_help = examples("sm2-manager"))]
struct Command {
    #[command(flatten)]
    arguments: Arguments,
}

fn main() -> ExitCode {
    serve(&Command::parse().arguments)
}
