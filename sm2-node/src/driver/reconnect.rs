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
use sm2_proto::{Code, Farewell, Instant, Refusal};

use super::datagram::Incoming;
use super::{Inner, SESSION, TIMER, Topic};

/// The longest that the first attempt waits.
const FIRST: Duration = Duration::from_millis(10);
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
            backoff: Backoff::new(RandomState::new().hash_one(std::process::id())),
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
        let at = now.after(self.backoff.next());
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

/// How long to wait before each attempt.
//= SM2-RES-001
#[derive(Clone, Debug)]
struct Backoff {
    /// The longest that the next wait can be.
    longest: Duration,
    random: u64,
}

impl Backoff {
    const fn new(seed: u64) -> Self {
        Self {
            longest: FIRST,
            random: seed,
        }
    }

    /// The node was back for so long. Two sides that do not get along must not greet each other
    /// as often as they can: a session that ends at once counts as one more attempt.
    fn ended_after(&mut self, session: Duration) {
        if session >= LONGEST {
            self.longest = FIRST;
        }
    }

    /// The first time anything up to `FIRST`: all nodes of a domain lose their Manager at the
    /// same moment. Then twice as long each time, and never less than half of that.
    fn next(&mut self) -> Duration {
        let longest = self.longest;
        self.longest = (longest * 2).min(LONGEST);
        let shortest = if longest == FIRST {
            Duration::ZERO
        } else {
            longest / 2
        };
        let span_ns = (longest - shortest).as_nanos() as u64;
        shortest + Duration::from_nanos(self.random() % (span_ns + 1))
    }

    /// SplitMix64.
    const fn random(&mut self) -> u64 {
        self.random = self.random.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.random;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        z ^ (z >> 31)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    //= SM2-RES-001 test
    #[test]
    fn waits_double_up_to_the_longest_and_differ_from_node_to_node() {
        let limits = [10, 20, 40, 80, 160, 250, 250, 250].map(Duration::from_millis);
        let mut seen = std::collections::BTreeSet::new();
        for seed in 0..500 {
            let mut backoff = Backoff::new(seed);
            for round in 0..2 {
                for (at, limit) in limits.into_iter().enumerate() {
                    let wait = backoff.next();
                    assert!(wait <= limit, "{wait:?} of {limit:?}");
                    assert!(at == 0 || wait >= limit / 2, "{wait:?} of {limit:?}");
                    seen.insert(wait);
                }
                assert!(round == 0 || seen.len() > limits.len());
                // A session that was none changes nothing.
                backoff.ended_after(LONGEST - Duration::from_nanos(1));
                assert!(backoff.next() >= LONGEST / 2);
                backoff.ended_after(LONGEST);
            }
        }
        assert!(seen.len() > 7_000, "{} of 8,000 waits differ", seen.len());
        let first = |seed| Backoff::new(seed).next();
        let half = FIRST / 2;
        assert!((0..100).any(|seed| first(seed) < half));
        assert!((0..100).any(|seed| first(seed) > half));
    }
}
