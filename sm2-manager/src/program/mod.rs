//! The command line of a Manager: `sm2-manager` and `sm2 manager`.
//!
//! | exit status | |
//! | --- | --- |
//! | 0 | stopped by SIGINT or SIGTERM, or another Manager has taken over (SIGUSR2) |
//! | 1 | it did not start, or could not go on: standard error says why |
//! | 2 | wrong usage |

mod activation;
mod arguments;
#[cfg(feature = "fuzzing")]
pub mod fuzz;
mod replace;

use std::{
    io::{self, IsTerminal},
    path::PathBuf,
    process::ExitCode,
    thread,
};

use nix::sys::resource::{Resource, getrlimit, setrlimit};
use sd_notify::NotifyState;
use signal_hook::{
    consts::{SIGINT, SIGTERM, SIGUSR2},
    iterator::Signals,
};
use sm2_io::DomainSocketError;

pub use self::{activation::ActivationError, arguments::Arguments, replace::ReplaceError};
use crate::{HandOver, Manager, Outcome, Role, RunError, Standby, StartError, Stopper};

/// What the help of the command that takes [`Arguments`] ends with. `command` is what it is
/// called: `sm2-manager`, `sm2 manager`.
#[must_use]
pub fn examples(command: &str) -> String {
    format!(
        "\
It serves until Ctrl-C or SIGTERM, or until another one has taken over. SIGUSR2 makes it hand
over, without a gap, to a standby or to whoever starts now; if nobody comes it goes on.
SM2_LOG (error, warn, info, debug) says what it logs on standard error.

Exit status: 0 stopped or handed over, 1 it could not start or go on, 2 wrong usage.

Examples:
  {command}
  {command} --domain arm --seal-all
  {command} --socket /run/robot/sm2.sock --socket-mode 660
  {command} --standby    serve, or wait for the end of whoever does
  {command} --replace    take the place of whoever serves"
    )
}

/// Why the program ended badly.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ProgramError {
    /// Another one serves, and nobody said what to do about that.
    #[error(
        "another Manager serves {path:?}: wait for its end with --standby, take its place with --replace, or choose another domain with --domain"
    )]
    Busy {
        /// The socket's path.
        path: PathBuf,
    },
    /// It did not start.
    #[error(transparent)]
    Start(StartError),
    /// The place of the Manager that serves was not to be had.
    #[error(transparent)]
    Replace(#[from] ReplaceError),
    /// What the service manager handed over is of no use.
    #[error(transparent)]
    Activation(#[from] ActivationError),
    /// A socket was handed over, but the command line asks for more.
    #[error(
        "a listening socket was handed over (LISTEN_FDS): --standby and --replace are for a Manager that makes its own"
    )]
    HandedAnyway,
    /// A socket was handed over, but the command line asks for another one.
    #[error("the socket that was handed over is {handed:?}, and the command line says {asked:?}")]
    OtherSocket {
        /// Its path.
        handed: PathBuf,
        /// What the command line says.
        asked: PathBuf,
    },
    /// It could not go on.
    #[error(transparent)]
    Run(#[from] RunError),
    /// Signals cannot be caught.
    #[error("cannot catch signals: {0}")]
    Signals(#[source] io::Error),
}

impl From<StartError> for ProgramError {
    fn from(error: StartError) -> Self {
        match error {
            StartError::DomainSocket(DomainSocketError::Busy { path }) => Self::Busy { path },
            error => Self::Start(error),
        }
    }
}

/// What runs.
enum Service {
    Manager(Box<Manager>),
    Standby(Box<Standby>),
}

impl Service {
    fn start(arguments: &Arguments) -> Result<Self, ProgramError> {
        let options = arguments.options();
        if let Some(socket) = activation::socket()? {
            if arguments.standby || arguments.replace {
                return Err(ProgramError::HandedAnyway);
            }
            let manager = Manager::adopt(socket, options)?;
            let asked = arguments.explicit_path()?;
            if let Some(asked) = asked.filter(|asked| asked != manager.path()) {
                let handed = manager.path().to_owned();
                return Err(ProgramError::OtherSocket { handed, asked });
            }
            return Ok(Self::Manager(Box::new(manager)));
        }
        let path = arguments.path()?;
        if arguments.standby {
            let standby = Standby::start(&path, options)?;
            return Ok(Self::Standby(Box::new(standby)));
        }
        let manager = if arguments.replace {
            replace::take_over(&path, options)?
        } else {
            Manager::bind(&path, options)?
        };
        Ok(Self::Manager(Box::new(manager)))
    }

    fn handles(&self) -> (Stopper, HandOver) {
        match self {
            Self::Manager(manager) => (manager.stopper(), manager.hand_over()),
            Self::Standby(standby) => (standby.stopper(), standby.hand_over()),
        }
    }

    fn run(self) -> Result<Outcome, RunError> {
        match self {
            Self::Manager(manager) => {
                say_role(Role::Serving);
                manager.run()
            }
            Self::Standby(mut standby) => standby.run(say_role),
        }
    }
}

fn say_role(role: Role) {
    let status = match role {
        Role::Serving => "Serving",
        Role::StandingBy => "Standing by: another Manager serves",
    };
    activation::tell(&[NotifyState::Ready, NotifyState::Status(status)]);
}

/// Serves until SIGINT or SIGTERM, or until another Manager has taken over after SIGUSR2.
///
/// # Errors
///
/// As [`Manager::bind`], [`Manager::adopt`], [`Standby::start`] and [`Manager::run`].
pub fn serve(arguments: &Arguments) -> Result<(), ProgramError> {
    raise_file_limit();
    // Before anybody can find out that this process serves: SIGUSR2 would end it.
    let mut signals = Signals::new([SIGINT, SIGTERM, SIGUSR2]).map_err(ProgramError::Signals)?;
    let service = Service::start(arguments)?;
    let (stopper, hand_over) = service.handles();
    let handle = signals.handle();
    let waiter = thread::spawn(move || {
        for signal in signals.forever() {
            if signal == SIGUSR2 {
                hand_over.start();
            } else {
                activation::tell(&[NotifyState::Stopping]);
                stopper.stop();
            }
        }
    });
    let result = service.run();
    handle.close();
    // The thread holds nothing but wakers: if it panicked, nothing is lost.
    let _ = waiter.join();
    if result? == Outcome::HandedOver {
        activation::tell(&[NotifyState::Stopping]);
    }
    Ok(())
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

/// A domain of n nodes needs 2 n descriptors, and the usual soft limit is 1,024.
fn raise_file_limit() {
    if let Ok((soft, hard)) = getrlimit(Resource::RLIMIT_NOFILE)
        && soft < hard
    {
        // The old limit serves a smaller domain.
        let _ = setrlimit(Resource::RLIMIT_NOFILE, hard, hard);
    }
}
