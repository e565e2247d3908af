//! Nodes whose process does not run, because a signal or a debugger stopped it.

use std::fmt;

use serde::Serialize;
use sm2_proto::{Name, domain::NodeView};

use crate::process;

/// A node whose process is stopped. Its links stay, and it takes no messages.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub(crate) struct StoppedNode {
    pub(crate) node: Name,
    pub(crate) pid: i32,
    by: StoppedBy,
}

/// The reason why the kernel does not run a process.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
enum StoppedBy {
    /// SIGSTOP, SIGTSTP, SIGTTIN or SIGTTOU.
    Signal,
    /// A tracer, such as gdb or strace.
    Debugger,
}

impl StoppedNode {
    /// Reads the state of the node's process from `/proc`. `None` if the process runs, or if this
    /// program cannot see it.
    pub(crate) fn find(node: &NodeView<'_>) -> Option<Self> {
        let by = state(&process::stat(node)?)?;
        Some(Self {
            node: node.name.clone(),
            pid: node.pid,
            by,
        })
    }

    /// The remedy, as an imperative clause.
    pub(crate) fn remedy(&self) -> String {
        match self.by {
            StoppedBy::Signal => format!("continue it with `kill -CONT {}`", self.pid),
            StoppedBy::Debugger => format!("let the debugger of process {} continue", self.pid),
        }
    }
}

/// `node camera (process 77) is stopped by a signal`
impl fmt::Display for StoppedNode {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { node, pid, by } = self;
        let by = match by {
            StoppedBy::Signal => "a signal",
            StoppedBy::Debugger => "a debugger",
        };
        write!(f, "node {node} (process {pid}) is stopped by {by}")
    }
}

/// The state in the fields of `/proc/PID/stat`: `T 1 …`.
fn state(stat: &str) -> Option<StoppedBy> {
    match stat.chars().next()? {
        'T' => Some(StoppedBy::Signal),
        't' => Some(StoppedBy::Debugger),
        _ => None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_state_is_the_first_field() {
        assert_eq!(state("S 1 77"), None);
        assert_eq!(state("T 1 77"), Some(StoppedBy::Signal));
        assert_eq!(state("t 1 77"), Some(StoppedBy::Debugger));
        assert_eq!(state(""), None);
    }
}
