//! The arguments of the command.

use std::process::ExitCode;

const USAGE: &str = "usage: verification/check [--quick] [--only WORD...]
       verification/check --table

Runs every check that this machine can run, and compares what they covered with PROPERTIES.md.

  --quick      leave out the checks marked `full`, and let each engine keep to its quick bounds
  --only       only these engines, properties or harnesses
  --table      print the numbers of checks of each group, engine and property, and run nothing

Status 0: all held and the files say so; 1: not so, or nothing was run; 2: it could not be tried;
77: this machine can run none of it; 130: interrupted.
Logs and results of each engine are in target/verification/.";

/// The command line.
#[derive(Debug, Default)]
pub(crate) struct Args {
    pub(crate) quick: bool,
    pub(crate) action: Action,
    /// The selected engines, properties and harnesses; empty for all.
    pub(crate) only: Vec<String>,
}

/// The task of the program.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) enum Action {
    /// Runs the checks.
    #[default]
    Run,
    /// Prints the numbers of checks.
    PrintTable,
}

impl Args {
    /// Parses the arguments after the program's name. The error is the exit status.
    pub(crate) fn parse(words: impl Iterator<Item = String>) -> Result<Self, ExitCode> {
        let mut args = Self::default();
        let mut naming = false;
        for word in words {
            match word.as_str() {
                "--quick" => args.quick = true,
                "--table" => args.action = Action::PrintTable,
                "--only" => naming = true,
                "--help" | "-h" => {
                    println!("{USAGE}");
                    return Err(ExitCode::SUCCESS);
                }
                name if naming && !name.starts_with('-') => args.only.push(word),
                _ => {
                    eprintln!("check: `{word}` was not expected\n{USAGE}");
                    return Err(ExitCode::from(2));
                }
            }
        }
        if naming && args.only.is_empty() {
            eprintln!("check: --only what?\n{USAGE}");
            return Err(ExitCode::from(2));
        }
        Ok(args)
    }
}
