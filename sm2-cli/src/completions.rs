//! `sm2 completions`, and the answers to a shell that completes a command line.
//!
//! The script of a shell runs `sm2` itself with the variable `COMPLETE`, for each key that completes. So the
//! completions know the names in the running domain ([`domain`]) beside all commands and options.

mod arguments;
mod domain;

use std::{
    env,
    ffi::OsString,
    io::{self, Write},
    process::ExitCode,
};

use clap::{Args, Command, ValueEnum};
use clap_complete::{
    CompleteEnv,
    env::{Bash, EnvCompleter, Fish, Shells, Zsh},
};

use crate::{ended::Ended, error::CliError, output::Output};

/// The variable that tells that a shell asks for completions, or for its script. It has the name of the shell.
const VARIABLE: &str = "COMPLETE";

/// `sm2 completions`.
#[derive(Args, Debug)]
#[command(after_help = HELP)]
pub(crate) struct Arguments {
    /// The shell
    #[arg(value_enum, value_name = "SHELL")]
    shell: For,
}

const HELP: &str = "\
The script asks sm2 itself, so it completes the topics, services, nodes and parameters of the running domain
too, that of --domain, --socket or the environment. Without a Manager it completes commands and options.

Bash and fish load the file of such a script themselves, if its folder exists (bash needs the package
bash-completion). For zsh, write 'source <(sm2 completions zsh)' to ~/.zshrc after compinit, or put the
script as _sm2 into a folder that ~/.zshrc adds to fpath before compinit. The Debian package of sm2 has
all three.

Examples:
  sm2 completions bash > ~/.local/share/bash-completion/completions/sm2
  sm2 completions zsh > ~/.zfunc/_sm2
  sm2 completions fish > ~/.config/fish/completions/sm2.fish";

/// The end of the script of zsh. A file of the search path is the body of a function, which zsh calls for the first
/// completion: it has to complete then, too.
const ZSH_IN_PATH: &[u8] = b"[[ $funcstack[1] != _sm2 ]] || _clap_dynamic_completer_sm2 \"$@\"\n";

#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum For {
    Bash,
    Zsh,
    Fish,
}

/// Prints the completion script of a shell.
///
/// # Errors
///
/// [`CliError::Output`].
pub(crate) fn run(arguments: &Arguments) -> Result<Ended, CliError> {
    let shell: &dyn EnvCompleter = match arguments.shell {
        For::Bash => &Bash,
        For::Zsh => &Zsh,
        For::Fish => &Fish,
    };
    let mut script = Vec::new();
    let written = shell.write_registration(VARIABLE, "sm2", "sm2", "sm2", &mut script);
    written.map_err(CliError::Output)?;
    if arguments.shell == For::Zsh {
        script.extend_from_slice(ZSH_IN_PATH);
    }
    let mut out = Output::new();
    out.write(|out| out.write_all(&script))?;
    Ok(Ended::Done)
}

/// Answers a shell, if it has asked for completions of the commands below `root`. Returns the exit status then.
///
/// Nothing is written to standard error, because it would stand in the middle of the person's command line.
pub(crate) fn answer(arguments: &[OsString], root: fn() -> Command) -> Option<ExitCode> {
    let shells: [&dyn EnvCompleter; 3] = [&Bash, &Zsh, &Fish];
    let complete = CompleteEnv::with_factory(|| arguments::with_values(root()))
        .var(VARIABLE)
        .bin("sm2")
        .shells(Shells(&shells));
    let folder = env::current_dir().ok();
    match complete.try_complete(arguments, folder.as_deref()) {
        Ok(false) => None,
        Ok(true) => Some(match io::stdout().flush() {
            Ok(()) => ExitCode::SUCCESS,
            Err(_) => ExitCode::FAILURE,
        }),
        Err(_) => Some(ExitCode::FAILURE),
    }
}
