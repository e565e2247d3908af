//! Coming back after the session ended: when to try, and trying.
//!
//! No call is needed for it but those that move the node on anyway, and whoever waits for
//! the node's descriptor is woken by a timer in the same epoll set.

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

/// The longest that any attempt waits.
const LONGEST: Duration = Duration::from_millis(250);

/// When the node tries to reach a Manager again.
#[derive(Debug)]
pub(super) struct Reconnect {
    path: PathBuf,
    timer: Timer,
    backoff: Backoff,
    /// Since when a Manager knows all of this node.
    back_since: Option<Instant>,
    /// Why the last attempt failed, which is said once.
    cause: Option<Cause>,
}

/// Why an attempt failed.
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

    /// Tries again after a while.
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

    /// The node is back.
    pub(super) fn done(&mut self) {
        self.back_since = Some(sm2_io::clock::now());
        self.cause = None;
    }

    /// Whether this is news.
    fn fails(&mut self, cause: Cause) -> bool {
        self.cause.replace(cause.clone()) != Some(cause)
    }
}

impl Inner {
    /// The session is over, but not by us: the node will connect again.
    //= SM2-RES-001
    pub(super) fn come_back(&mut self, end: End) {
        if !matches!(end, End::Local(_)) {
            self.reconnect.plan();
        }
    }

    /// The time for an attempt has come.
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

    /// The Manager did not grant a greeting: that attempt failed as any other.
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

/// Whether a Manager that ended the session like this before it welcomed the node may be about
/// to be replaced by another.
pub(crate) fn may_return(end: End) -> bool {
    const SHUTTING_DOWN: Code = Farewell::ShuttingDown.code();
    matches!(end, End::Eof | End::Peer(SHUTTING_DOWN))
}
