//! A command's node: connecting to the Manager, and waiting for events.

use std::{
    cell::Cell,
    fs, io,
    os::{
        fd::{AsFd, BorrowedFd},
        unix::fs::FileTypeExt,
    },
    path::{Path, PathBuf},
    process,
    time::Duration,
};

use sm2_io::clock;
use sm2_node::{ConnectError, Node};
use sm2_proto::{Instant, TypeId, domain::Domain as Mirror};

use crate::{
    args::Domain,
    error::CliError,
    interrupt::{Interrupt, Stopped},
    time::Span,
    wait::{For, wait},
};

/// The number of names that are tried. Processes in different containers may have the same number.
const NAMES: u32 = 16;

/// A wait for a Manager is cut into steps of this length, so that a signal ends the wait soon.
const STEP: Duration = Duration::from_millis(100);

/// The node of a command, and the signals that end the command.
pub(crate) struct CommandNode {
    pub(crate) node: Node,
    interrupt: Interrupt,
    /// Whether the Manager was connected at the last check.
    connected: Cell<bool>,
    /// Suppresses the messages about the Manager.
    silent: Cell<bool>,
}

impl CommandNode {
    /// Connects to the domain's Manager under a name of `role` and this process' number. Raises the limit of
    /// descriptors before, since other nodes decide how many links, topics or counter files a command has.
    ///
    /// # Errors
    ///
    /// [`CliError::NoManager`], [`CliError::Connect`], [`CliError::DomainSocket`],
    /// [`CliError::Stopped`] by a signal while it waits for a Manager.
    pub(crate) fn open(domain: &Domain, role: &str) -> Result<Self, CliError> {
        sm2_io::raise_descriptor_limit();
        let interrupt = Interrupt::install().map_err(CliError::system("catch signals"))?;
        let node = domain.connect(&domain.path()?, role, &interrupt)?;
        Ok(Self::new(node, interrupt))
    }

    /// The session of a node that is connected.
    pub(crate) fn new(node: Node, interrupt: Interrupt) -> Self {
        Self {
            node,
            interrupt,
            connected: Cell::new(true),
            silent: Cell::new(false),
        }
    }

    /// Suppresses messages about the Manager from now on, for a command that uses the whole screen.
    pub(crate) fn be_silent(&self) {
        self.silent.set(true);
    }

    /// Whether a Manager is connected. Reports on standard error when the Manager ends and when its successor
    /// comes.
    pub(crate) fn is_connected(&self) -> bool {
        let connected = self.node.is_connected();
        if self.connected.replace(connected) != connected && !self.silent.get() {
            stderr_line!(
                "sm2: {}",
                match connected {
                    true => "a Manager is there again",
                    false =>
                        "the Manager is gone: links go on, waiting for its successor (Ctrl-C ends)",
                }
            );
        }
        connected
    }

    /// Lets one more signal end the command.
    ///
    /// # Errors
    ///
    /// [`CliError::System`] if the operating system refuses it.
    pub(crate) fn end_on(&self, signal: i32) -> Result<(), CliError> {
        (self.interrupt.add(signal)).map_err(CliError::system("catch a signal"))
    }

    /// The signal that ends the command, if one came.
    pub(crate) fn stopped(&self) -> Option<Stopped> {
        self.interrupt.signal()
    }

    /// Ends the command with an error if a signal came.
    ///
    /// # Errors
    ///
    /// [`CliError::Stopped`].
    pub(crate) fn fail_if_stopped(&self) -> Result<(), CliError> {
        self.stopped()
            .map_or(Ok(()), |signal| Err(CliError::Stopped(signal)))
    }

    /// The signal that came since the last call, if one did. For [`Interrupt::install_each`].
    pub(crate) fn take_signal(&self) -> Option<Stopped> {
        self.interrupt.take()
    }

    /// A descriptor that becomes readable when a signal comes.
    pub(crate) fn signal_fd(&self) -> BorrowedFd<'_> {
        self.interrupt.as_fd()
    }

    /// Waits until one of `others` is ready, the node has work, a signal comes, or the time `until`. The node
    /// then does its work. Returns which of `others` are ready.
    ///
    /// # Errors
    ///
    /// [`CliError::System`] if waiting fails.
    pub(crate) fn step(
        &self,
        others: &[(BorrowedFd<'_>, For)],
        until: Option<Instant>,
    ) -> Result<Vec<bool>, CliError> {
        let interrupt = (self.interrupt.as_fd(), For::Reading);
        let others: Vec<_> = others.iter().copied().chain([interrupt]).collect();
        let (moved, ready) = drive(&self.node, &others, until)?;
        if moved {
            self.is_connected();
        }
        Ok(ready)
    }

    /// Drives the node until `until`. Returns true if a signal came before that time.
    ///
    /// # Errors
    ///
    /// As [`step`](Self::step).
    pub(crate) fn pause(&self, until: Instant) -> Result<bool, CliError> {
        loop {
            self.step(&[], Some(until))?;
            if self.stopped().is_some() {
                return Ok(true);
            }
            if clock::now() >= until {
                return Ok(false);
            }
        }
    }

    /// The state of the domain at one revision.
    ///
    /// # Errors
    ///
    /// [`CliError::Query`].
    pub(crate) fn snapshot(&self) -> Result<Mirror, CliError> {
        Ok(self.node.snapshot()?)
    }

    /// The schema text of a type, if a node has registered it.
    ///
    /// # Errors
    ///
    /// [`CliError::Query`].
    pub(crate) fn describe(&self, data: &TypeId) -> Result<Option<String>, CliError> {
        Ok(self.node.describe(data)?)
    }
}

/// Waits until `node` has work, one of `others` is ready, or the time `until`. The node then does its work.
/// Returns whether the node had work, and which of `others` are ready.
pub(crate) fn drive(
    node: &Node,
    others: &[(BorrowedFd<'_>, For)],
    until: Option<Instant>,
) -> Result<(bool, Vec<bool>), CliError> {
    let failed = || CliError::system("wait for messages");
    let fds = [&[(node.as_fd(), For::Reading)], others].concat();
    let timeout = until.map(|until| until.since(clock::now()));
    let mut ready = wait(&fds, timeout).map_err(failed())?;
    let moved = ready.remove(0);
    if moved {
        node.spin_some().map_err(failed())?;
    }
    Ok((moved, ready))
}

impl Domain {
    /// The path of the Manager's socket.
    ///
    /// # Errors
    ///
    /// [`CliError::DomainSocket`].
    pub(crate) fn path(&self) -> Result<PathBuf, CliError> {
        match &self.socket {
            Some(path) => Ok(path.clone()),
            None => Ok(sm2_io::socket_path(self.domain.as_deref())?),
        }
    }

    /// Connects a node to the Manager at `path`. Waits for a Manager if `--wait-manager` was given.
    ///
    /// # Errors
    ///
    /// As [`CommandNode::open`].
    pub(crate) fn connect(
        &self,
        path: &Path,
        role: &str,
        interrupt: &Interrupt,
    ) -> Result<Node, CliError> {
        let mut until = self.wait_manager.map(|timeout| clock::now().after(timeout));
        let mut said = false;
        loop {
            let left = until.map(|until| until.since(clock::now()).min(STEP));
            let result = self.connect_once(path, role, left);
            if let Some(signal) = interrupt.signal() {
                return Err(CliError::Stopped(signal));
            }
            let waiting = until.is_some_and(|until| clock::now() < until);
            match result {
                Err(ConnectError::NoManager { .. }) if waiting && is_absent_or_socket(path) => {
                    if !said {
                        said = true;
                        let timeout = Span(self.wait_manager.unwrap_or_default());
                        let path = path.display();
                        stderr_line!(
                            "sm2: waiting {timeout} for a Manager at {path} (Ctrl-C ends)"
                        );
                    }
                }
                Err(error) => return Err(self.explain(path, error)),
                Ok(node) => return Ok(node),
            }
            // One more attempt after the deadline, without a startup timeout.
            if left == Some(Duration::ZERO) {
                until = None;
            }
        }
    }

    /// Connects a further node of a command. Its name has a number.
    ///
    /// # Errors
    ///
    /// [`ConnectError`].
    pub(crate) fn connect_further(&self, path: &Path, role: &str) -> Result<Node, ConnectError> {
        self.connect_once(path, role, None)
    }

    fn connect_once(
        &self,
        path: &Path,
        role: &str,
        timeout: Option<Duration>,
    ) -> Result<Node, ConnectError> {
        let name = format!("sm2-{role}-{}", process::id());
        let connect = |name: &str| {
            let builder = Node::builder(name)
                .socket(path)
                .manager_timeout(self.connect_timeout);
            match timeout {
                Some(timeout) => builder.startup_timeout(timeout).connect(),
                None => builder.connect(),
            }
        };
        let mut result = connect(&name);
        for number in 2..=NAMES {
            if !matches!(result, Err(ConnectError::NameTaken { .. })) {
                break;
            }
            result = connect(&format!("{name}-{number}"));
        }
        result
    }

    /// Replaces an error that the socket's path explains by one that says so.
    fn explain(&self, path: &Path, error: ConnectError) -> CliError {
        match error {
            ConnectError::NoManager { .. } if !is_absent_or_socket(path) => {
                CliError::NotASocket { path: path.into() }
            }
            ConnectError::NoManager { path, .. } => CliError::NoManager {
                path,
                option: self.option(),
            },
            ConnectError::Io { path, source }
                if source.kind() == io::ErrorKind::PermissionDenied =>
            {
                CliError::MayNotConnect { path, source }
            }
            ConnectError::Io { path, source }
                if source.raw_os_error() == Some(nix::libc::EPROTOTYPE) =>
            {
                CliError::NotASocket { path }
            }
            error => CliError::Connect(error),
        }
    }

    /// The option that makes `sm2 manager` use the same socket.
    fn option(&self) -> String {
        match (&self.socket, &self.domain) {
            (Some(path), _) => format!(" --socket {}", path.display()),
            (None, Some(domain)) => format!(" --domain {domain}"),
            (None, None) => String::new(),
        }
    }
}

/// Whether the path is free or a socket, so that a Manager may listen there.
fn is_absent_or_socket(path: &Path) -> bool {
    fs::metadata(path).map_or(true, |found| found.file_type().is_socket())
}
