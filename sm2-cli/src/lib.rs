//! The `sm2` command: an SM2 domain from a shell.
//!
//! Each command or group of commands has a module. `sm2 manager` is [`sm2_manager::program`], and `sm2 gateway`
//! is [`sm2_gateway::program`]. A command returns an `ended::Ended` or an `error::CliError`; only this file turns
//! them into an exit status and a line on standard error. The crate is a library so that fuzz targets can
//! use it: `main.rs` only calls [`main`].
//!
//! Modules that commands share: `connect` (the node, and signals), `follow` (changes of the domain), `view` (indexes of
//! the domain) and `names` (names on the command line). Those for counters are `sampling`, `observation` and `troubles`
//! (what counters tell about links). Those for output are `report` (a value as JSON or as text), `columns` (the columns
//! of rows), `output` and `colours`.
#![forbid(unsafe_code)]
#![deny(clippy::disallowed_types)]

#[macro_use]
mod stderr;

mod args;
mod bag;
mod bag_choice;
mod bag_summary;
mod built_in;
mod colours;
mod columns;
mod command;
mod completions;
mod compression;
mod connect;
mod decode;
mod demo;
mod doctor;
mod ended;
mod error;
mod follow;
mod foxglove;
#[cfg(feature = "fuzzing")]
pub mod fuzz;
mod interface_troubles;
mod interfaces;
mod interrupt;
mod limits;
mod manual;
mod messages;
mod names;
mod new_robot;
mod node;
mod observation;
mod output;
mod param;
mod play;
mod policy;
mod printable;
mod process;
mod record;
#[cfg(test)]
mod reference;
mod report;
mod ros_types;
mod sampling;
mod service;
mod size;
mod snapshot;
mod stopped;
mod text;
mod ticker;
mod time;
mod top;
mod topic;
mod topic_patterns;
mod transcode;
mod troubles;
mod up;
mod usage;
mod view;
mod wait;
mod wait_for;
mod web_view;
mod why;

use std::{env, ffi::OsString, io, process::ExitCode};

use clap::CommandFactory;
use tracing_subscriber::{
    filter::Targets, layer::SubscriberExt as _, util::SubscriberInitExt as _,
};

pub use crate::transcode::Transcoder;
use crate::{
    command::{Cli, Command},
    ended::Ended,
    error::CliError,
};

/// Runs the command of the command line, and returns its exit status.
#[must_use]
pub fn main() -> ExitCode {
    run(usage::by_name_of_program(env::args_os().collect()))
}

/// Runs a command, and returns its exit status. The first argument stands for the program. Call it once in a process.
#[must_use]
pub fn run(arguments: Vec<OsString>) -> ExitCode {
    if let Some(status) = completions::answer(&arguments, Cli::command) {
        return status;
    }
    let command = match usage::parse(arguments) {
        Ok(command) => command,
        Err(status) => return status,
    };
    if !matches!(command, Command::Manager(_) | Command::Gateway(_))
        && let Err(wrong) = log_errors()
    {
        stderr_line!("sm2: {}", text::one_line(&wrong.to_string()));
        return ExitCode::from(ended::WRONG_USAGE);
    }
    let result = match command {
        Command::Manager(arguments) => return sm2_manager::program::main(&arguments),
        Command::Gateway(command) => return sm2_gateway::program::main(&command, "sm2"),
        Command::Topic(command) => topic::run(&command),
        Command::Service(command) => service::run(&command),
        Command::Node(command) => node::run(&command),
        Command::Param(command) => param::run(&command),
        Command::Snapshot(arguments) => snapshot::run(&arguments),
        Command::Wait(arguments) => wait_for::run(&arguments),
        Command::Why(arguments) => why::run(&arguments),
        Command::Top(arguments) => top::run(&arguments),
        Command::View(arguments) => web_view::run(&arguments),
        Command::Foxglove(arguments) => Err(foxglove::run(&arguments)),
        Command::Doctor(arguments) => doctor::run(&arguments),
        Command::Record(arguments) => record::run(&arguments),
        Command::Play(arguments) => play::run(&arguments),
        Command::Bag(command) => bag::run(&command),
        Command::Policy(command) => policy::run(&command),
        Command::Completions(arguments) => completions::run(&arguments),
        Command::Man(arguments) => manual::run(&arguments, Cli::command()),
        Command::Demo(arguments) => demo::run(&arguments),
        Command::DemoPart(arguments) => demo::run_process(&arguments),
        Command::New(arguments) => new_robot::run(&arguments),
        Command::Up(arguments) => up::run(&arguments),
        Command::UpGuard(arguments) => up::run_guard(&arguments),
    };
    match result.and_then(|ended| output::written().map(|()| ended)) {
        Ok(Ended::Done) => ExitCode::SUCCESS,
        Ok(Ended::No) => ExitCode::FAILURE,
        Ok(Ended::NotWorking) => ExitCode::from(ended::NOT_WORKING),
        Ok(Ended::Stopped(signal)) => ExitCode::from(signal.status()),
        Err(error) if error.is_broken_pipe() => ExitCode::SUCCESS,
        Err(error @ CliError::Stopped(_)) => ExitCode::from(error.status()),
        Err(error) => {
            // The text may contain control characters of a server's reply.
            stderr::error(&text::one_line(&error.to_string()));
            ExitCode::from(error.status())
        }
    }
}

/// Logs to standard error with the level of `SM2_LOG`. The default is `error`, since commands report all other
/// events themselves.
fn log_errors() -> Result<(), sm2_io::WrongLogLevel> {
    let logs = tracing_subscriber::fmt::layer()
        .with_ansi(colours::are_on_stderr())
        .with_writer(io::stderr);
    let filter: Targets =
        (sm2_io::log_levels("error")?.parse()).expect("`log_levels` has checked them");
    tracing_subscriber::registry()
        .with(filter)
        .with(logs)
        .init();
    Ok(())
}
