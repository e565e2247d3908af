//! `manager`: the Manager as the `sm2 manager` command runs it.

use std::process::ExitCode;

use clap::Parser;
use sm2_manager::program;

use crate::{input::abort_at_end, options::Options};

#[derive(Parser)]
struct Line {
    #[command(flatten)]
    arguments: program::Arguments,
}

/// Runs a Manager until its standard input ends.
#[must_use]
pub fn run(options: &Options) -> ExitCode {
    abort_at_end();
    // `Options::limit_files` has handled that one.
    let options = options.iter().filter(|(name, _)| *name != "--nofile");
    let words = options.flat_map(|(name, value)| match value {
        // An option of the program that takes no value.
        "true" => vec![name],
        value => vec![name, value],
    });
    let line = Line::parse_from(["manager"].into_iter().chain(words));
    program::main(&line.arguments)
}
