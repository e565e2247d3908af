//! A command's node: connecting it, and waiting with it.

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

/// How many names are tried: processes in different containers may have the same number.
const NAMES: u32 = 16;

/// A wait for a Manager is cut into steps of this length, to look for signals in between.
const STEP: Duration = Duration::from_millis(100);

/// A command in its domain, until it is interrupted.
pub(crate) struct Session {
    pub(crate) node: Node,
    interrupt: Interrupt,
    /// Whether the Manager was there when this was last looked at.
    connected: Cell<bool>,
    /// Whether nothing is said of the Manager's coming and going.
    silent: Cell<bool>,
}

impl Session {
    /// Connects to the domain's Manager under a name of `role` and this process' number.
    ///
    /// # Errors
    ///
    /// [`CliError::NoManager`], [`CliError::Connect`], [`CliError::DomainSocket`],
    /// [`CliError::Stopped`] by a signal while it waits for a Manager.
    pub(crate) fn open(domain: &Domain, role: &str) -> Result<Self, CliError> {
        let interrupt = Interrupt::install().map_err(CliError::system("catch signals"))?;
        let node = domain.connect(&domain.path()?, role, &interrupt)?;
        Ok(Self {
            node,
            interrupt,
            connected: Cell::new(true),
            silent: Cell::new(false),
        })
    }

    /// Says nothing of the Manager from now on: for a command that has the whole screen.
    pub(crate) fn be_silent(&self) {
        self.silent.set(true);
    }

    /// Whether there is a Manager. Says on standard error when it goes, and when one comes again.
    pub(crate) fn is_connected(&self) -> bool {
        let connected = self.node.is_connected();
        if self.connected.replace(connected) != connected && !self.silent.get() {
            say!(
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

    /// The signal that ends the command, once it came.
    pub(crate) fn stopped(&self) -> Option<Stopped> {
        self.interrupt.signal()
    }

    /// Waits until one of `others` is ready, the node has something to do, which it then does, a
    /// signal comes, or `until`; which of `others` are ready.
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

    /// Moves the node on until `until`; whether a signal came before.
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

    /// What there is in the domain, at one revision.
    ///
    /// # Errors
    ///
    /// [`CliError::Query`].
    pub(crate) fn snapshot(&self) -> Result<Mirror, CliError> {
        Ok(self.node.snapshot()?)
    }

    /// The schema text of a type, if somebody has registered it.
    ///
    /// # Errors
    ///
    /// [`CliError::Query`].
    pub(crate) fn describe(&self, data: &TypeId) -> Result<Option<String>, CliError> {
        Ok(self.node.describe(data)?)
    }
}

/// Waits until `node` has something to do, which it then does, one of `others` is ready, or `until`.
/// Whether the node had something to do, and which of `others` are ready.
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

    /// Connects a node to the Manager at `path`, and waits for that as long as was asked for.
    ///
    /// # Errors
    ///
    /// As [`Session::open`].
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
                        say!("sm2: waiting {timeout} for a Manager at {path} (Ctrl-C ends)");
                    }
                }
                Err(error) => return Err(self.explain(path, error)),
                Ok(node) => return Ok(node),
            }
            // Once, after the time is over.
            if left == Some(Duration::ZERO) {
                until = None;
            }
        }
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

    /// What is wrong with the path, where that is what keeps the node out.
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

    /// How `sm2 manager` is told the same.
    fn option(&self) -> String {
        match (&self.socket, &self.domain) {
            (Some(path), _) => format!(" --socket {}", path.display()),
            (None, Some(domain)) => format!(" --domain {domain}"),
            (None, None) => String::new(),
        }
    }
}

/// Whether a Manager may have been, or may come, at this path.
fn is_absent_or_socket(path: &Path) -> bool {
    fs::metadata(path).map_or(true, |found| found.file_type().is_socket())
}
