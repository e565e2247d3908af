//! The command line of a Manager: `sm2-manager` and `sm2 manager`.

use std::{
    io::{self, IsTerminal},
    path::PathBuf,
    process::ExitCode,
    thread,
    time::Duration,
};

use clap::Args;
use nix::sys::resource::{Resource, getrlimit, setrlimit};
use signal_hook::{
    consts::{SIGINT, SIGTERM},
    iterator::Signals,
};
use sm2_proto::manager::Policy;

use crate::{Manager, Options, RunError, StartError};

/// Options of a Manager's command line.
#[derive(Args, Clone, Debug)]
pub struct Arguments {
    /// The domain to serve [default: $SM2_DOMAIN, else `default`]
    #[arg(long, value_name = "NAME")]
    pub domain: Option<String>,
    /// Listen at this path instead of the domain's
    #[arg(long, value_name = "PATH", conflicts_with = "domain")]
    pub socket: Option<PathBuf>,
    /// Permissions of the socket, octal: who may connect needs to write
    #[arg(long, value_name = "MODE", default_value = "600", value_parser = octal)]
    pub socket_mode: u32,
    /// Seal every message of the domain
    #[arg(long)]
    pub seal_all: bool,
    /// Let links between different users go unsealed
    #[arg(long, conflicts_with = "seal_all")]
    pub waive_user_boundary: bool,
    /// Sessions that one user may have
    #[arg(long, value_name = "N", value_parser = positive, default_value_t = Policy::default().sessions_per_user)]
    pub max_sessions: usize,
    /// Interfaces that one node may have
    #[arg(long, value_name = "N", default_value_t = Policy::default().interfaces_per_session)]
    pub max_interfaces: usize,
    /// Ends of links that one node may have
    #[arg(long, value_name = "N", default_value_t = Policy::default().links_per_session)]
    pub max_links: usize,
    /// Seconds that a connection may take to greet
    #[arg(long, value_name = "SECONDS", default_value_t = 2, value_parser = clap::value_parser!(u64).range(1..))]
    pub greeting_timeout: u64,
}

/// Why the program ended badly.
#[derive(Debug, thiserror::Error)]
pub enum ProgramError {
    /// It did not start.
    #[error(transparent)]
    Start(#[from] StartError),
    /// It could not go on.
    #[error(transparent)]
    Run(#[from] RunError),
    /// Signals cannot be caught.
    #[error("cannot catch signals: {0}")]
    Signals(#[source] io::Error),
}

impl Arguments {
    fn options(&self) -> Options {
        let policy = Policy {
            greeting: Duration::from_secs(self.greeting_timeout),
            sessions_per_user: self.max_sessions,
            interfaces_per_session: self.max_interfaces,
            links_per_session: self.max_links,
            seal_all: self.seal_all,
            waive_user_boundary: self.waive_user_boundary,
            ..Policy::default()
        };
        Options {
            policy,
            socket_mode: self.socket_mode,
            ..Options::default()
        }
    }

    fn path(&self) -> Result<PathBuf, StartError> {
        match &self.socket {
            Some(path) => Ok(path.clone()),
            None => Ok(sm2_io::socket_path(self.domain.as_deref())?),
        }
    }
}

/// Serves until SIGINT or SIGTERM.
///
/// # Errors
///
/// As [`Manager::bind`] and [`Manager::run`].
pub fn serve(arguments: &Arguments) -> Result<(), ProgramError> {
    raise_file_limit();
    let mut signals = Signals::new([SIGINT, SIGTERM]).map_err(ProgramError::Signals)?;
    let manager = Manager::bind(&arguments.path()?, arguments.options())?;
    let stopper = manager.stopper();
    let handle = signals.handle();
    let waiter = thread::spawn(move || {
        if signals.forever().next().is_some() {
            stopper.stop();
        }
    });
    let result = manager.run();
    handle.close();
    // The thread holds nothing but a waker: if it panicked, nothing is lost.
    let _ = waiter.join();
    Ok(result?)
}

/// As [`serve`], with logs on standard error (`SM2_LOG` filters them) and an exit status.
#[must_use]
pub fn main(arguments: &Arguments) -> ExitCode {
    let filter = tracing_subscriber::EnvFilter::try_from_env("SM2_LOG")
        .unwrap_or_else(|_| tracing_subscriber::EnvFilter::new("info"));
    let logs = tracing_subscriber::fmt()
        .with_env_filter(filter)
        .with_ansi(io::stderr().is_terminal())
        .with_writer(io::stderr);
    // Fails only where a program has logging already, which is as good.
    let _ = logs.try_init();
    match serve(arguments) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("sm2 manager: {error}");
            ExitCode::FAILURE
        }
    }
}

/// A domain of n nodes needs n descriptors, and the usual soft limit is 1,024.
fn raise_file_limit() {
    if let Ok((soft, hard)) = getrlimit(Resource::RLIMIT_NOFILE)
        && soft < hard
    {
        // The old limit serves a smaller domain.
        let _ = setrlimit(Resource::RLIMIT_NOFILE, hard, hard);
    }
}

fn octal(text: &str) -> Result<u32, String> {
    match u32::from_str_radix(text, 8) {
        Ok(mode) if mode <= 0o777 => Ok(mode),
        _ => Err("give permissions as octal digits, such as 660".into()),
    }
}

/// Nobody could join a Manager that allows none.
fn positive(text: &str) -> Result<usize, String> {
    match text.parse() {
        Ok(count) if count > 0 => Ok(count),
        _ => Err("give a whole number of at least 1".into()),
    }
}
