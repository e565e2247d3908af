//! The state of the domain, kept up to date for commands that run for a while.

use std::{
    os::fd::{AsFd, BorrowedFd},
    time::Duration,
};

use sm2_io::clock;
use sm2_node::domain::{QueryError, Watch};
use sm2_proto::{Instant, control::Change, domain::Domain};

use crate::{connect::CommandNode, error::CliError, output::Output, wait::For};

/// The domain of a session, as it changes. The Manager answers each request when something has changed, so
/// there is no polling.
pub(crate) struct Follow<'a> {
    command_node: &'a CommandNode,
    watch: Watch,
}

/// The reasons why a wait ended.
#[derive(Clone, Debug, Default)]
pub(crate) struct Woken {
    /// The changes of the domain, in their order.
    pub(crate) changes: Vec<Change>,
    /// For each of the other descriptors, whether it is ready.
    pub(crate) ready: Vec<bool>,
}

impl<'a> Follow<'a> {
    /// Reads the domain as it is now, within `timeout`.
    ///
    /// # Errors
    ///
    /// [`CliError::Query`].
    pub(crate) fn new(command_node: &'a CommandNode, timeout: Duration) -> Result<Self, CliError> {
        let mut watch = command_node.node.watch();
        // The first answer is never empty: it contains this node.
        if watch.wait_timeout(timeout)?.is_empty() {
            return Err(QueryError::TimedOut.into());
        }
        Ok(Self {
            command_node,
            watch,
        })
    }

    /// The last known state of the domain.
    pub(crate) fn domain(&self) -> &Domain {
        self.watch.domain()
    }

    /// Waits until the domain changes, one of `others` is ready, a signal comes, or `until`.
    ///
    /// # Errors
    ///
    /// [`CliError::Query`], [`CliError::System`].
    pub(crate) fn wait(
        &mut self,
        others: &[(BorrowedFd<'_>, For)],
        until: Option<Instant>,
    ) -> Result<Woken, CliError> {
        let changes = self.watch.try_wait()?;
        if !changes.is_empty() {
            self.command_node.is_connected();
            let ready = vec![false; others.len()];
            return Ok(Woken { changes, ready });
        }
        let mut ready = self.command_node.step(others, until)?;
        ready.truncate(others.len());
        let changes = self.watch.try_wait()?;
        Ok(Woken { changes, ready })
    }

    /// Waits until `due`, and looks for signals even if that is over. Returns false if the command should end instead:
    /// a signal came, or the reader of its output is gone.
    ///
    /// # Errors
    ///
    /// Those of [`wait`](Self::wait).
    pub(crate) fn sleep(&mut self, out: &Output, due: Instant) -> Result<bool, CliError> {
        loop {
            let woken = self.wait(&[(out.as_fd(), For::Hangup)], Some(due))?;
            if self.command_node.stopped().is_some() || woken.ready == [true] {
                return Ok(false);
            }
            if clock::now() >= due {
                return Ok(true);
            }
        }
    }
}
