//! Parses the command line, and reports an error in one line.

use std::{ffi::OsString, path::Path, process::ExitCode};

use clap::{
    CommandFactory, Parser,
    error::{Error, ErrorKind},
};

use crate::{
    command::{Cli, Command},
    ended::WRONG_USAGE,
    stderr, up,
};

/// Parses a command line, whose first argument is the program.
///
/// # Errors
///
/// The exit status, if there is no command to run: the help, the version or an error has been printed.
pub(crate) fn parse(arguments: Vec<OsString>) -> Result<Command, ExitCode> {
    let error = match read(&arguments) {
        Ok(command) => return Ok(command),
        Err(error) => error,
    };
    match error.kind() {
        ErrorKind::DisplayHelp | ErrorKind::DisplayVersion => {
            // If standard output is closed, there is nobody to report the error to.
            let _ = error.print();
            Err(ExitCode::SUCCESS)
        }
        ErrorKind::DisplayHelpOnMissingArgumentOrSubcommand => {
            let _ = error.print();
            Err(ExitCode::from(WRONG_USAGE))
        }
        _ => {
            stderr::error(&one_line(&error, &arguments));
            Err(ExitCode::from(WRONG_USAGE))
        }
    }
}

/// The arguments of a program that is a link to `sm2`, as those of `sm2` itself: `sm2-manager` is `sm2 manager`. So a
/// package has three programs in one file.
pub(crate) fn by_name_of_program(mut arguments: Vec<OsString>) -> Vec<OsString> {
    let program = arguments.first().map(Path::new);
    let name = program.and_then(|it| it.file_name()?.to_str());
    let command = match name {
        Some("sm2-manager") => "manager",
        Some("sm2-gateway") => "gateway",
        _ => return arguments,
    };
    // All of them have one version.
    if arguments
        .get(1)
        .is_some_and(|it| it == "--version" || it == "-V")
    {
        return arguments;
    }
    arguments.insert(1, command.into());
    arguments
}

/// Parses a command line without printing anything.
pub(crate) fn read(arguments: &[OsString]) -> Result<Command, Error> {
    // Not a command of clap, so that it appears neither in the help nor in completions.
    match arguments.get(1) {
        Some(word) if word == sm2_demo::COMMAND => {
            sm2_demo::ProcessArguments::try_parse_from(&arguments[1..]).map(Command::DemoPart)
        }
        Some(word) if word == up::GUARD => {
            up::GuardArguments::try_parse_from(&arguments[1..]).map(Command::UpGuard)
        }
        _ => Cli::try_parse_from(arguments).map(|cli| cli.command),
    }
}

/// The error on one line, without clap's prefix and usage. The end names the command that prints help.
pub(crate) fn one_line(error: &Error, arguments: &[OsString]) -> String {
    let rendered = error.render().to_string();
    let lines = rendered
        .lines()
        .map(str::trim)
        .take_while(|line| !line.starts_with("Usage:") && !line.starts_with("For more information"))
        .filter(|line| !line.is_empty());
    let message = lines.collect::<Vec<_>>().join(" ");
    let message = message.strip_prefix("error: ").unwrap_or(&message);
    format!("{message} (see `{} --help`)", command_of(arguments))
}

/// The command that the arguments start with, such as `sm2 topic pub`.
fn command_of(arguments: &[OsString]) -> String {
    let mut command = Cli::command();
    let mut words = vec![command.get_name().to_owned()];
    for argument in arguments.iter().skip(1) {
        let Some(next) = command.find_subcommand(argument).cloned() else {
            break;
        };
        words.push(next.get_name().to_owned());
        command = next;
    }
    words.join(" ")
}

#[cfg(test)]
mod tests;
