//! `sm2 foxglove`: becomes the program `sm2-foxglove`, which is installed on its own.

use std::{
    env, ffi::OsString, os::unix::process::CommandExt as _, path::PathBuf, process::Command,
};

use clap::Args;

use crate::error::CliError;

/// The program, in the folder of this one or in a folder of `PATH`.
const PROGRAM: &str = "sm2-foxglove";

/// `sm2 foxglove`.
#[derive(Args, Debug)]
pub(crate) struct Arguments {
    /// The arguments of sm2-foxglove: `sm2-foxglove --help` lists them
    #[arg(
        value_name = "ARGUMENT",
        trailing_var_arg = true,
        allow_hyphen_values = true
    )]
    arguments: Vec<OsString>,
}

/// Runs the command. It returns only if the program cannot be started.
pub(crate) fn run(arguments: &Arguments) -> CliError {
    let beside = env::current_exe().map(|it| it.with_file_name(PROGRAM));
    let beside = beside.ok().filter(|it| it.exists());
    let program = beside.unwrap_or_else(|| PathBuf::from(PROGRAM));
    let source = Command::new(program).args(&arguments.arguments).exec();
    CliError::NotInstalled {
        program: PROGRAM,
        source,
    }
}
