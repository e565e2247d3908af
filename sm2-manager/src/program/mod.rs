//! The command line of a Manager: `sm2-manager` and `sm2 manager`.
//!
//! | exit status | |
//! | --- | --- |
//! | 0 | stopped by SIGINT or SIGTERM, or another Manager has taken over (SIGUSR2) |
//! | 1 | the Manager did not start or could not continue; standard error says why |
//! | 2 | wrong usage |

mod activation;
mod arguments;
#[cfg(feature = "fuzzing")]
pub mod fuzz;
mod limit_arguments;
mod reach;
mod replace;

use std::{
    io::{self, IsTerminal, Write},
    path::PathBuf,
    process::ExitCode,
    sync::mpsc,
    thread,
};

use nix::sys::prctl::set_no_new_privs;
use sd_notify::NotifyState;
use signal_hook::{
    consts::{SIGHUP, SIGINT, SIGTERM, SIGUSR2},
    iterator::Signals,
};
use sm2_io::DomainSocketError;
use sm2_proto::control::LimitError;
use tracing::warn;
use tracing_subscriber::{
    filter::Targets, layer::SubscriberExt as _, util::SubscriberInitExt as _,
};

pub use self::{
    activation::ActivationError, arguments::Arguments, limit_arguments::LimitArguments,
    replace::ReplaceError,
};
use crate::{
    HandOver, Manager, Outcome, PolicyReloader, Role, RunError, Standby, StartError, Stopper,
};

/// The exit status of a command line that cannot be used. It is that of clap.
const WRONG_USAGE: u8 = 2;

/// Returns the end of the help text for the command that takes [`Arguments`]. `command` is its name:
/// `sm2-manager` or `sm2 manager`.
#[must_use]
pub fn examples(command: &str) -> String {
    format!(
        "\
The Manager serves until Ctrl-C or SIGTERM, or until another Manager has taken over. SIGUSR2
makes it hand over without a gap to a standby or to a Manager that starts now; if none takes
over, it continues to serve. SIGHUP makes it read the access policy again; the log says when the
policy is applied, or why the one before stays in force. SM2_LOG (error, warn, info, debug) sets
the log level on standard error.

Exit status: 0 stopped or handed over, 1 could not start or continue, 2 wrong usage.

Examples:
  {command}
  {command} --domain arm --seal-all
  {command} --socket /run/robot/sm2.sock --socket-mode 660
  {command} --standby    serve, or wait until the Manager that serves ends
  {command} --replace    replace the Manager that serves"
    )
}

/// The reason why the program failed.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ProgramError {
    /// Another Manager serves, and the command line does not say what to do then.
    #[error(
        "another Manager serves {path:?}: wait for its end with --standby, take its place with --replace, or \
         choose another domain with --domain"
    )]
    Busy {
        /// The socket's path.
        path: PathBuf,
    },
    /// The command line states a wrong limit.
    #[error(transparent)]
    Limit(#[from] LimitError),
    /// The Manager did not start.
    #[error(transparent)]
    Start(StartError),
    /// The Manager that serves was not replaced.
    #[error(transparent)]
    Replace(#[from] ReplaceError),
    /// The sockets that the service manager passed cannot be used.
    #[error(transparent)]
    Activation(#[from] ActivationError),
    /// A socket was passed, but the command line has options for a Manager that creates its own.
    #[error(
        "--standby and --replace do not work with socket activation (LISTEN_FDS is set): drop the option, or \
         start the Manager without a socket unit"
    )]
    HandedAnyway,
    /// A socket was passed, but the command line names another one.
    #[error(
        "the service manager passed the socket {handed:?}, but --socket or --domain asks for {asked:?}: name \
         the same path in both, or drop the option"
    )]
    OtherSocket {
        /// The path of the socket that was passed.
        handed: PathBuf,
        /// The path from the command line.
        asked: PathBuf,
    },
    /// The Manager could not continue.
    #[error(transparent)]
    Run(#[from] RunError),
    /// Signal handlers cannot be installed.
    #[error("cannot catch signals: {0}")]
    Signals(io::Error),
    /// The thread for signals cannot be started.
    #[error("cannot start a thread: {0}; `ulimit -u` shows the limit")]
    Thread(io::Error),
}

impl From<StartError> for ProgramError {
    fn from(error: StartError) -> Self {
        match error {
            StartError::DomainSocket(DomainSocketError::Busy { path }) => Self::Busy { path },
            error => Self::Start(error),
        }
    }
}

/// The handles that let signals act on a Manager.
type Handles = (Stopper, HandOver, PolicyReloader);

impl ProgramError {
    fn exit_code(&self) -> ExitCode {
        match self {
            Self::Limit(_) => ExitCode::from(WRONG_USAGE),
            _ => ExitCode::FAILURE,
        }
    }
}

/// The Manager that this process runs.
enum Service {
    Manager(Box<Manager>),
    Standby(Box<Standby>),
}

impl Service {
    fn start(arguments: &Arguments) -> Result<Self, ProgramError> {
        let options = arguments.options()?;
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
            reach::warn_of_closed_directory(&path, arguments.socket_mode);
            return Ok(Self::Standby(Box::new(standby)));
        }
        let manager = if arguments.replace {
            replace::take_over(&path, options)?
        } else {
            Manager::bind(&path, options)?
        };
        // Binding creates the directory if it does not exist.
        reach::warn_of_closed_directory(&path, arguments.socket_mode);
        Ok(Self::Manager(Box::new(manager)))
    }

    fn handles(&self) -> Handles {
        match self {
            Self::Manager(it) => (it.stopper(), it.hand_over(), it.policy_reload()),
            Self::Standby(it) => (it.stopper(), it.hand_over(), it.policy_reload()),
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

/// Serves until SIGINT or SIGTERM, or until another Manager has taken over after SIGUSR2. SIGHUP makes the Manager
/// read the access policy again.
///
/// # Errors
///
/// As [`Manager::bind`], [`Manager::adopt`], [`Standby::start`] and [`Manager::run`].
pub fn serve(arguments: &Arguments) -> Result<(), ProgramError> {
    // A domain of n nodes needs 2 n descriptors.
    sm2_io::raise_descriptor_limit();
    give_up_new_rights();
    // Before the domain is claimed: without handlers, SIGUSR2 and SIGHUP would kill this process.
    let mut signals =
        Signals::new([SIGINT, SIGTERM, SIGUSR2, SIGHUP]).map_err(ProgramError::Signals)?;
    let handle = signals.handle();
    let (sender, handles) = mpsc::channel::<Handles>();
    // Before the domain is claimed, too: without this thread, the Manager that serves now must go on.
    let waiter = thread::Builder::new().name("signals".to_owned());
    let waiter = waiter.spawn(move || {
        // Fails if the Manager does not start.
        let Ok((stopper, hand_over, policy_reload)) = handles.recv() else {
            return;
        };
        for signal in signals.forever() {
            match signal {
                SIGUSR2 => hand_over.start(),
                SIGHUP => policy_reload.start(),
                _ => {
                    activation::tell(&[NotifyState::Stopping]);
                    stopper.stop();
                }
            }
        }
    });
    let waiter = waiter.map_err(ProgramError::Thread)?;
    let service = Service::start(arguments)?;
    // Fails only if the thread has panicked.
    let _ = sender.send(service.handles());
    let result = service.run();
    handle.close();
    // The thread owns only wakers, so a panic in it loses nothing.
    let _ = waiter.join();
    if result? == Outcome::HandedOver {
        activation::tell(&[NotifyState::Stopping]);
    }
    Ok(())
}

/// As [`serve`], with logs on standard error (`SM2_LOG` filters them) and an exit status.
#[must_use]
pub fn main(arguments: &Arguments) -> ExitCode {
    let levels = match sm2_io::log_levels("info") {
        Ok(levels) => levels,
        Err(wrong) => {
            let _ = writeln!(io::stderr(), "sm2 manager: {wrong}");
            return ExitCode::from(WRONG_USAGE);
        }
    };
    let logs = tracing_subscriber::fmt::layer()
        .with_ansi(io::stderr().is_terminal())
        .with_writer(io::stderr);
    let filter: Targets = levels.parse().expect("`log_levels` has checked them");
    // Fails only if the program has installed a logger already, which serves as well.
    let _ = tracing_subscriber::registry()
        .with(filter)
        .with(logs)
        .try_init();
    match serve(arguments) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            // Standard error may be closed.
            let _ = writeln!(io::stderr(), "sm2 manager: {error}");
            error.exit_code()
        }
    }
}

/// Gives up the right to gain rights by executing a program, which a Manager never does. The threads of this
/// process inherit this.
fn give_up_new_rights() {
    if let Err(error) = set_no_new_privs() {
        warn!(%error, "this process can still gain rights by executing programs");
    }
}
