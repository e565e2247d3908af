//! The schedule of the attempts to connect to a Manager again.

use std::collections::hash_map::RandomState;
use std::hash::BuildHasher;
use std::io;
use std::path::PathBuf;
use std::time::Duration;

use sm2_io::{Interest, Timer};
use sm2_proto::node::End;
use sm2_proto::{Backoff, Code, Farewell, Instant, Refusal};

use crate::driver::event_sets::NodeSets;
use crate::driver::token::TIMER;

/// The longest delay between two attempts.
const LONGEST: Duration = Duration::from_millis(250);

/// The schedule of the attempts to connect to a Manager.
#[derive(Debug)]
pub(in crate::driver) struct Reconnect {
    pub(super) path: PathBuf,
    pub(super) timer: Timer,
    backoff: Backoff,
    /// The time since which a Manager knows all interfaces of this node.
    back_since: Option<Instant>,
    /// The reason why the last attempt failed. Each reason is logged once in a row.
    cause: Option<Cause>,
}

/// The reason why an attempt failed.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) enum Cause {
    Connect(io::ErrorKind),
    Refused(Refusal),
}

impl Reconnect {
    pub(in crate::driver) fn new(path: PathBuf, sets: &NodeSets) -> io::Result<Self> {
        let timer = Timer::new()?;
        sets.control.add(&timer, TIMER, Interest::READABLE)?;
        Ok(Self {
            path,
            timer,
            backoff: Backoff::new(RandomState::new().hash_one(std::process::id()), LONGEST),
            back_since: None,
            cause: None,
        })
    }

    /// Schedules the next attempt.
    pub(super) fn plan(&mut self) {
        let now = sm2_io::clock::now();
        if let Some(since) = self.back_since.take() {
            self.backoff.ended_after(now.since(since));
        }
        let at = now.after(self.backoff.wait());
        if let Err(error) = self.timer.set(Some(at)) {
            tracing::error!(%error, "cannot set the reconnect timer: restart this program to reach a Manager");
        }
    }

    /// Notes that a Manager knows all interfaces of this node.
    pub(in crate::driver) fn done(&mut self) {
        self.back_since = Some(sm2_io::clock::now());
        self.cause = None;
    }

    /// Notes a failed attempt. Returns whether its cause differs from that of the attempt before.
    pub(super) fn fails(&mut self, cause: Cause) -> bool {
        self.cause.replace(cause.clone()) != Some(cause)
    }
}

/// Whether a node connects again after a session that ended in this way before it was welcomed: another Manager may be
/// about to replace this one, or the greeting came too late because the machine is busy.
pub(crate) fn may_return(end: End) -> bool {
    const SHUTTING_DOWN: Code = Farewell::ShuttingDown.code();
    const GREETING_TIMEOUT: Code = Farewell::GreetingTimeout.code();
    matches!(end, End::Eof | End::Peer(SHUTTING_DOWN | GREETING_TIMEOUT))
}
