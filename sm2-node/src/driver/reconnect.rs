//! Connecting to a Manager again after a session has ended.
//!
//! Attempts happen when a call drives the node. A timer in the node's epoll set signals the next
//! attempt, so it also wakes a program that polls the node's descriptor.

use std::collections::hash_map::RandomState;
use std::hash::BuildHasher;
use std::io;
use std::path::{Path, PathBuf};
use std::time::Duration;

use sm2_io::{Epoll, Interest, SeqPacket, Timer};
use sm2_proto::node::{End, Input};
use sm2_proto::{Backoff, Code, Farewell, Instant, Refusal};

use super::datagram::Incoming;
use super::{Inner, SESSION, TIMER, Topic};

/// The longest delay between two attempts.
const LONGEST: Duration = Duration::from_millis(250);

/// The schedule of the attempts to connect to a Manager.
#[derive(Debug)]
pub(super) struct Reconnect {
    path: PathBuf,
    timer: Timer,
    backoff: Backoff,
    /// The time since which a Manager knows all interfaces of this node.
    back_since: Option<Instant>,
    /// The reason why the last attempt failed. Each reason is logged once in a row.
    cause: Option<Cause>,
}

/// The reason why an attempt failed.
#[derive(Clone, Debug, PartialEq, Eq)]
enum Cause {
    Connect(io::ErrorKind),
    Refused(Refusal),
}

impl Reconnect {
    pub(super) fn new(path: PathBuf, epoll: &Epoll) -> io::Result<Self> {
        let timer = Timer::new()?;
        epoll.add(&timer, TIMER, Interest::READABLE)?;
        Ok(Self {
            path,
            timer,
            backoff: Backoff::new(RandomState::new().hash_one(std::process::id()), LONGEST),
            back_since: None,
            cause: None,
        })
    }

    /// Schedules the next attempt.
    fn plan(&mut self) {
        let now = sm2_io::clock::now();
        if let Some(since) = self.back_since.take() {
            self.backoff.ended_after(now.since(since));
        }
        let at = now.after(self.backoff.wait());
        if let Err(error) = self.timer.set(Some(at)) {
            tracing::error!(%error, "cannot set the timer: this node will not come back");
        }
    }

    /// Notes that a Manager knows all interfaces of this node.
    pub(super) fn done(&mut self) {
        self.back_since = Some(sm2_io::clock::now());
        self.cause = None;
    }

    /// Notes a failed attempt. Returns whether its cause differs from that of the attempt before.
    fn fails(&mut self, cause: Cause) -> bool {
        self.cause.replace(cause.clone()) != Some(cause)
    }
}

impl Inner {
    /// Schedules an attempt to connect, unless this side ended the session.
    //= SM2-RES-001
    pub(super) fn come_back(&mut self, end: End) {
        if !matches!(end, End::Local(_)) {
            self.reconnect.plan();
        }
    }

    /// Handles the timer: tries to connect.
    //= SM2-RES-001
    pub(super) fn on_timer(&mut self, epoll: &Epoll) {
        if !self.reconnect.timer.drain() {
            return;
        }
        let path: &Path = &self.reconnect.path;
        let connected = SeqPacket::connect(path).and_then(|socket| {
            epoll.add(&socket, SESSION, Interest::READABLE)?;
            Ok(socket)
        });
        match connected {
            Ok(socket) => {
                self.session.connected(socket);
                self.session.tell(Input::Reconnected);
                self.drain_session(Incoming::default(), epoll);
            }
            Err(error) => {
                if self.reconnect.fails(Cause::Connect(error.kind())) {
                    tracing::warn!(
                        path = ?self.reconnect.path, %error,
                        "no Manager; links go on, and this node goes on trying"
                    );
                }
                self.reconnect.plan();
            }
        }
        self.sleepers.wake(Topic::Session);
    }

    /// Handles a refused greeting, which counts as a failed attempt.
    //= SM2-RES-001
    pub(super) fn greeting_refused(&mut self, reason: Refusal) {
        if self.session.was_welcomed() && self.reconnect.fails(Cause::Refused(reason.clone())) {
            tracing::warn!(%reason, "the new Manager does not take this node; links go on, and it goes on trying");
        }
        self.session.refused = Some(reason);
        self.session.tell(Input::Eof);
        self.sleepers.wake(Topic::Session);
    }
}

/// Whether another Manager may be about to replace a Manager that ended the session in this way
/// before it welcomed the node.
pub(crate) fn may_return(end: End) -> bool {
    const SHUTTING_DOWN: Code = Farewell::ShuttingDown.code();
    matches!(end, End::Eof | End::Peer(SHUTTING_DOWN))
}
