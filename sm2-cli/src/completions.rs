//! `sm2 completions`: prints scripts by which a shell completes this command.

use std::io::Write;

use clap::{Args, Command, ValueEnum};
use clap_complete::{Shell, generate};

use crate::{ended::Ended, error::CliError, output::Output};

/// `sm2 completions`.
#[derive(Args, Debug)]
#[command(after_help = HELP)]
pub(crate) struct Arguments {
    /// The shell
    #[arg(value_enum, value_name = "SHELL")]
    shell: For,
}

const HELP: &str = "\
Examples:
  sm2 completions bash > ~/.local/share/bash-completion/completions/sm2
  sm2 completions zsh > \"${fpath[1]}/_sm2\"
  sm2 completions fish > ~/.config/fish/completions/sm2.fish";

#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum For {
    Bash,
    Zsh,
    Fish,
}

/// Prints the completion script of `root`.
///
/// # Errors
///
/// [`CliError::Output`].
pub(crate) fn run(arguments: &Arguments, mut root: Command) -> Result<Ended, CliError> {
    let shell = match arguments.shell {
        For::Bash => Shell::Bash,
        For::Zsh => Shell::Zsh,
        For::Fish => Shell::Fish,
    };
    // The generator panics if a write fails, so it writes into memory.
    let mut script = Vec::new();
    generate(shell, &mut root, "sm2", &mut script);
    let mut out = Output::new();
    out.write(|out| out.write_all(&script))?;
    Ok(Ended::Done)
}
