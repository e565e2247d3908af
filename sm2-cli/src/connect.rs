//! A command's node: connecting it, and waiting with it.

use std::{
    os::fd::{AsFd, BorrowedFd},
    path::{Path, PathBuf},
    process,
    time::Duration,
};

use sm2_io::clock;
use sm2_node::{ConnectError, Graph, Node};
use sm2_proto::Instant;

use crate::{
    args::Domain,
    error::CliError,
    interrupt::{Interrupt, Stopped},
    wait::{For, wait},
};

/// How many names are tried: processes in different containers may have the same number.
const NAMES: u32 = 16;

/// How long the Manager may take to say what there is.
const GRAPH_TIMEOUT: Duration = Duration::from_secs(5);

/// A command in its domain, until it is interrupted.
pub(crate) struct Session {
    pub(crate) node: Node,
    interrupt: Interrupt,
}

impl Session {
    /// Connects to the domain's Manager under a name of `role` and this process' number.
    ///
    /// # Errors
    ///
    /// [`CliError::NoManager`], [`CliError::Connect`], [`CliError::Endpoint`].
    pub(crate) fn open(domain: &Domain, role: &str) -> Result<Self, CliError> {
        let interrupt = Interrupt::install().map_err(CliError::system("catch signals"))?;
        let path = domain.path()?;
        let node = connect(&path, role).map_err(|error| match error {
            ConnectError::NoManager { path, .. } => CliError::NoManager {
                path,
                option: domain.option(),
            },
            error => CliError::Connect(error),
        })?;
        Ok(Self { node, interrupt })
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
        step(&self.node, &others, until)
    }

    /// Moves the node on until `until`; whether a signal came before.
    ///
    /// # Errors
    ///
    /// As [`step`](Self::step).
    pub(crate) fn pause(&self, until: Instant) -> Result<bool, CliError> {
        pause(&self.node, self.interrupt.as_fd(), until)
    }

    /// What there is in the domain.
    ///
    /// # Errors
    ///
    /// [`CliError::Query`].
    pub(crate) fn graph(&self) -> Result<Graph, CliError> {
        Ok(self.node.graph(GRAPH_TIMEOUT)?)
    }
}

/// Waits until `node` has something to do, which it then does, one of `others` is ready, or `until`;
/// which of `others` are ready.
///
/// # Errors
///
/// [`CliError::System`] if waiting fails.
pub(crate) fn step(
    node: &Node,
    others: &[(BorrowedFd<'_>, For)],
    until: Option<Instant>,
) -> Result<Vec<bool>, CliError> {
    let failed = || CliError::system("wait for messages");
    let fds = [&[(node.as_fd(), For::Reading)], others].concat();
    let timeout = until.map(|until| until.since(clock::now()));
    let mut ready = wait(&fds, timeout).map_err(failed())?;
    if ready.remove(0) {
        node.spin_once(None).map_err(failed())?;
    }
    Ok(ready)
}

/// Moves `node` on until `until`; whether `stop` was readable before.
///
/// # Errors
///
/// As [`step`].
pub(crate) fn pause(node: &Node, stop: BorrowedFd<'_>, until: Instant) -> Result<bool, CliError> {
    loop {
        if step(node, &[(stop, For::Reading)], Some(until))? == [true] {
            return Ok(true);
        }
        if clock::now() >= until {
            return Ok(false);
        }
    }
}

fn connect(path: &Path, role: &str) -> Result<Node, ConnectError> {
    let name = format!("sm2-{role}-{}", process::id());
    let mut result = Node::builder(&name).socket(path).connect();
    for number in 2..=NAMES {
        if !matches!(result, Err(ConnectError::NameTaken { .. })) {
            break;
        }
        result = Node::builder(&format!("{name}-{number}"))
            .socket(path)
            .connect();
    }
    result
}

impl Domain {
    fn path(&self) -> Result<PathBuf, CliError> {
        match &self.socket {
            Some(path) => Ok(path.clone()),
            None => Ok(sm2_io::socket_path(self.domain.as_deref())?),
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
