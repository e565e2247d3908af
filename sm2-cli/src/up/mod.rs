//! `sm2 up`: starts the programs of a robot in order, restarts them, shows their logs, and ends them.
//!
//! [`robot`] describes the programs, which [`file`] reads. [`fleet`] has the state of each program and acts on it; this
//! file waits for events in between. [`guard`] ends the programs if this process is killed, and [`systemd`] writes
//! units for the same programs instead.

mod error;
mod file;
mod fleet;
mod guard;
mod limits;
mod lines;
mod process;
mod restarts;
mod robot;
mod show;
mod signals;
mod systemd;
mod waiting;

use std::{
    env,
    os::fd::{AsFd, BorrowedFd},
    path::{Path, PathBuf, absolute},
};

use clap::Args;
use nix::sys::prctl;
use signal_hook::consts::SIGCHLD;
use sm2_io::clock;
use sm2_node::{Node, domain::Watch};
use sm2_proto::{Instant, domain::Domain as Mirror};

pub(crate) use self::{
    error::UpError,
    guard::{GUARD, GuardArguments, run as run_guard},
};
use self::{
    file::MANAGER,
    fleet::Fleet,
    guard::Guard,
    limits::{MANAGER_STEP, MANAGER_TIMEOUT, QUESTION_RETRY, RESTARTS},
    robot::{Program, RestartPolicy},
    show::{Kind, Show},
    signals::{Order, Signals},
};
use crate::{
    args::Domain,
    connect::CommandNode,
    ended::Ended,
    error::CliError,
    interrupt::{Interrupt, SignalPipe, Stopped},
    time::Span,
    wait::{For, wait},
};

/// `sm2 up`.
#[derive(Args, Debug)]
#[command(after_help = HELP)]
pub(crate) struct Arguments {
    /// The file that describes the programs
    #[arg(value_name = "FILE", default_value = "robot.toml")]
    file: PathBuf,
    /// Print one JSON object for each event
    #[arg(long, conflicts_with = "systemd")]
    json: bool,
    /// Start nothing: write a systemd user unit for each program to this folder [default: that of the user's units]
    #[arg(long, value_name = "DIR", num_args = 0..=1)]
    systemd: Option<Option<PathBuf>>,
    #[command(flatten)]
    domain: Domain,
}

const HELP: &str = "\
A file has a table for each program:
  domain = \"robot\"              the domain of all programs [default: $SM2_DOMAIN, else `default`]
  manager = false               start no Manager, even if none serves
  stop_timeout = \"5s\"           the time from SIGTERM to SIGKILL [default: 5s]
  params = \"params.toml\"        a file of parameters for all programs, for $SM2_PARAMS
  [program.map]
  command = \"bin/map --fast\"    or a list of words
  directory = \"maps\"            the working directory [default: the folder of the file]
  environment = { LEVEL = \"1\" }
  params = \"map.toml\"           a file of parameters for this program
  after = [\"topic:scan publishers>=1\", \"node:lidar\"]
                                start when these conditions of `sm2 wait` hold
  restart = \"on-failure\"        or never, or always [default: on-failure]
  max_restarts = 5              [default: 5]
Relative paths are relative to the folder of the file.

Programs start in the order of the file, each as soon as its conditions hold, also when it starts
again. The delay of a restart is 500 ms, and doubles up to 10 s. A program that ran for 60 s has all
its restarts again.

Ctrl-C or SIGTERM ends the programs, the last one of the file first: SIGTERM to its process group, and
SIGKILL after stop_timeout. A second Ctrl-C, 500 ms later or more, sends SIGKILL to all. If sm2 up
itself is killed, its programs are ended, too.

If no Manager serves, one is started as the first program, and ended last.

Exit status: 0 every program succeeded or was ended by Ctrl-C, 1 a program failed for good or had to be
killed, 2 wrong usage or a wrong file, 130 or 143 a second Ctrl-C or SIGTERM.

Examples:
  sm2 up
  sm2 up robot.toml --json
  sm2 up robot.toml --systemd";

/// Runs the command.
///
/// # Errors
///
/// Any [`CliError`].
pub(crate) fn run(arguments: &Arguments) -> Result<Ended, CliError> {
    let robot = file::load(&arguments.file)?;
    let mut location = arguments.domain.clone();
    if location.socket.is_none() && location.domain.is_none() {
        location.domain.clone_from(&robot.domain);
    }
    let socket = location.path()?;
    let socket = absolute(&socket).map_err(|error| CliError::file("find", &socket, error))?;
    let itself = env::current_exe().map_err(CliError::system("find the program sm2"))?;
    if let Some(folder) = &arguments.systemd {
        let units = systemd::Units {
            robot: &robot,
            itself: &itself,
            socket: &socket,
        };
        return units.write(folder.as_deref());
    }
    let interrupt = Interrupt::install_each().map_err(CliError::system("catch signals"))?;
    let children = SignalPipe::install(SIGCHLD).map_err(CliError::system("catch SIGCHLD"))?;
    // The orphans of programs then belong to this process, which learns when the last one of a group has ended.
    let orphans = prctl::set_child_subreaper(true);
    orphans.map_err(|error| CliError::system("adopt processes")(error.into()))?;

    let node = connect(&location, &socket, &interrupt, robot.has_manager)?;
    let mut programs = robot.programs.clone();
    let first = usize::from(node.is_none());
    if node.is_none() {
        programs.insert(0, manager(&itself, &socket));
    }
    let names = programs.iter().map(|it| it.name.clone()).collect();
    let show = Show::start(names, arguments.json)?;
    let guard = Guard::start(itself, robot.stop_timeout)?;
    let fleet = Fleet::new(&programs, &socket, robot.stop_timeout, guard, show);
    let mut up = Up {
        fleet,
        first,
        children,
        signals: Signals::default(),
    };
    let ran = match node {
        Some(node) => up.run(CommandNode::new(node, interrupt)),
        None => up.start_manager(&location, &socket, interrupt),
    };
    let failed = up.fleet.has_failed();
    let written = up.fleet.show.finish();
    ran?;
    written?;
    Ok(match (up.signals.second(), failed) {
        (Some(signal), _) => Ended::Stopped(signal),
        (None, true) => Ended::No,
        (None, false) => Ended::Done,
    })
}

/// Connects to the Manager. `None` if none serves, and one may be started.
fn connect(
    location: &Domain,
    socket: &Path,
    interrupt: &Interrupt,
    may_start: bool,
) -> Result<Option<Node>, CliError> {
    match location.connect(socket, "up", interrupt) {
        Ok(node) => Ok(Some(node)),
        Err(CliError::NoManager { .. }) if may_start => Ok(None),
        Err(error) => Err(error),
    }
}

/// The Manager as a program. If another one comes first, it stands by.
fn manager(itself: &Path, socket: &Path) -> Program {
    let path = |path: &Path| path.to_string_lossy().into_owned();
    let words = ["manager", "--standby", "--socket"].map(str::to_owned);
    Program {
        name: MANAGER.to_owned(),
        command: [vec![path(itself)], words.to_vec(), vec![path(socket)]].concat(),
        folder: PathBuf::from("/"),
        environment: Vec::new(),
        policy: RestartPolicy::Always,
        max_restarts: RESTARTS,
        after: Vec::new(),
    }
}

/// A running `sm2 up`.
struct Up<'a> {
    fleet: Fleet<'a>,
    /// The position of the first program of the file: 1 after a Manager.
    first: usize,
    children: SignalPipe,
    signals: Signals,
}

impl Up<'_> {
    /// Starts the Manager, and all programs when it serves.
    fn start_manager(
        &mut self,
        location: &Domain,
        socket: &Path,
        interrupt: Interrupt,
    ) -> Result<(), CliError> {
        let until = clock::now().after(MANAGER_TIMEOUT);
        let location = Domain {
            wait_manager: None,
            ..location.clone()
        };
        let text = format!("no Manager serves {}: starting one", socket.display());
        self.fleet.show.own(Kind::Domain, text);
        let failure = loop {
            self.children.has_come();
            self.fleet.advance(1, None);
            self.take(interrupt.take());
            if self.signals.is_stopping() {
                break None;
            }
            // A reason that ends it now would end it again.
            if !self.fleet.is_running(0) {
                break Some(UpError::ManagerEnded.into());
            }
            match connect(&location, socket, &interrupt, true) {
                Ok(Some(node)) => return self.run(CommandNode::new(node, interrupt)),
                Ok(None) if until <= clock::now() => {
                    break Some(UpError::NoManager(Span(MANAGER_TIMEOUT)).into());
                }
                Ok(None) => {}
                Err(CliError::Stopped(_)) => continue,
                Err(error) => break Some(error),
            }
            self.wait(&interrupt, Some(clock::now().after(MANAGER_STEP)))?;
        };
        self.fleet.stop();
        while !self.fleet.is_over(0..) {
            self.take(interrupt.take());
            self.children.has_come();
            let next = self.fleet.advance(1, None);
            if !self.fleet.is_over(0..) {
                self.wait(&interrupt, next)?;
            }
        }
        failure.map_or(Ok(()), Err)
    }

    fn wait(&self, interrupt: &Interrupt, until: Option<Instant>) -> Result<(), CliError> {
        let fds = [self.fds(), vec![(interrupt.as_fd(), For::Reading)]].concat();
        let timeout = until.map(|until| until.since(clock::now()));
        let waited = wait(&fds, timeout);
        waited
            .map(|_| ())
            .map_err(CliError::system("wait for programs"))
    }

    fn fds(&self) -> Vec<(BorrowedFd<'_>, For)> {
        let mut fds = self.fleet.fds();
        fds.push((self.children.as_fd(), For::Reading));
        fds
    }

    /// Runs the programs to their end.
    fn run(&mut self, command_node: CommandNode) -> Result<(), CliError> {
        command_node.be_silent();
        let mut known = Known {
            watch: command_node.node.watch(),
            is_known: false,
            retry_at: None,
        };
        let mut is_connected = true;
        loop {
            // Before the question: a signal that comes later wakes the wait below.
            self.children.has_come();
            self.take(command_node.take_signal());
            if let Err(error) = known.update() {
                self.fleet.show.own(Kind::Domain, error.to_string());
            }
            if !self.fleet.is_ending() && is_connected != command_node.is_connected() {
                is_connected = !is_connected;
                let text = match is_connected {
                    true => "a Manager is there again",
                    false => "the Manager is gone: links go on, and the programs run",
                };
                self.fleet.show.own(Kind::Domain, text);
            }
            let was_over = self.fleet.is_over(self.first..);
            if was_over {
                // The Manager is left.
                self.fleet.stop();
            }
            let next = self.fleet.advance(usize::MAX, known.domain());
            if self.fleet.is_over(0..) {
                self.fleet.show.own(Kind::Done, "all programs have ended");
                return Ok(());
            }
            if !was_over && self.fleet.is_over(self.first..) {
                continue;
            }
            let until = [next, known.retry_at].into_iter().flatten().min();
            command_node.step(&self.fds(), until)?;
        }
    }

    /// The first signal ends the programs, and a second one kills them.
    fn take(&mut self, signal: Option<Stopped>) {
        let order = signal.and_then(|signal| self.signals.take(clock::now(), signal));
        match order {
            None => {}
            Some(Order::Stop) => {
                let text = "ending all programs, the last one first (a second signal kills them)";
                self.fleet.show.own(Kind::Stopping, text);
                self.fleet.stop();
            }
            Some(Order::Kill) => {
                self.fleet.show.own(Kind::Killing, "killing all programs");
                self.fleet.kill();
            }
        }
    }
}

/// The state of the domain, as far as the Manager has told it.
struct Known {
    watch: Watch,
    is_known: bool,
    /// When the question is asked again, after an error.
    retry_at: Option<Instant>,
}

impl Known {
    /// Takes the changes that have come.
    fn update(&mut self) -> Result<(), CliError> {
        if self.retry_at.is_some_and(|at| clock::now() < at) {
            return Ok(());
        }
        self.retry_at = None;
        loop {
            match self.watch.try_wait() {
                // The next changes are asked for, and wake this process.
                Ok(changes) if changes.is_empty() => return Ok(()),
                // The first answer is never empty: it contains this node.
                Ok(_) => self.is_known = true,
                Err(error) => {
                    self.is_known = false;
                    self.retry_at = Some(clock::now().after(QUESTION_RETRY));
                    return Err(error.into());
                }
            }
        }
    }

    fn domain(&self) -> Option<&Mirror> {
        self.is_known.then(|| self.watch.domain())
    }
}
