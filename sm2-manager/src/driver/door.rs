//! The listening socket: accepts connections, and hands the domain over to another Manager.

use std::{
    io,
    path::{Path, PathBuf},
    time::Duration,
};

use sm2_io::{
    DomainSocket, DomainSocketError, Epoll, Interest, Listener, SeqPacket, UnlockedSocket, clock,
};
use sm2_proto::Instant;
use tracing::{info, warn};

/// The epoll token of the listening socket. Connections use their session number, which starts at 1.
pub(super) const LISTENER: u64 = u64::MAX;

/// How long accepting pauses when the process has no descriptor to spare.
const ACCEPT_PAUSE: Duration = Duration::from_millis(100);
/// How long a Manager that hands over waits for a successor.
const SUCCESSOR_TIMEOUT: Duration = Duration::from_secs(2);
/// How long the lock is left to Managers that try to take it directly, before standbys are dismissed.
const PRECEDENCE: Duration = Duration::from_millis(100);
/// How often a Manager that hands over checks for a successor.
const LOOK: Duration = Duration::from_millis(2);
/// How often it tries to take the domain back, once no successor has come.
const LOOK_LATE: Duration = Duration::from_millis(50);

#[derive(Debug)]
pub(super) struct Door {
    path: PathBuf,
    /// `None` only during a state change.
    claim: Option<Claim>,
    /// The socket was created by another process (socket activation), which keeps it for the next Manager.
    adopted: bool,
    accept_again: Option<Instant>,
}

#[derive(Debug)]
enum Claim {
    Held(DomainSocket),
    Offered(Offer),
}

#[derive(Debug)]
struct Offer {
    socket: UnlockedSocket,
    since: Instant,
    look_at: Instant,
}

/// The result of checking for a successor.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Found {
    /// Nothing new.
    Nothing,
    /// No Manager has taken the lock yet: standbys may now try.
    Unclaimed,
    /// A successor has put its socket in place.
    Successor,
}

impl Door {
    pub(super) fn new(endpoint: DomainSocket, adopted: bool) -> Self {
        Self {
            path: endpoint.path().to_owned(),
            claim: Some(Claim::Held(endpoint)),
            adopted,
            accept_again: None,
        }
    }

    pub(super) fn path(&self) -> &Path {
        &self.path
    }

    fn listener(&self) -> Option<&Listener> {
        self.claim.as_ref().map(|claim| match claim {
            Claim::Held(endpoint) => endpoint.listener(),
            Claim::Offered(offer) => offer.socket.listener(),
        })
    }

    pub(super) fn add_to(&self, epoll: &Epoll) -> io::Result<()> {
        match self.listener() {
            Some(listener) => epoll.add(listener, LISTENER, Interest::READABLE),
            None => Ok(()),
        }
    }

    /// Changes what the listening socket is watched for. Returns whether that succeeded.
    fn watch(&self, epoll: &Epoll, interest: Interest) -> bool {
        let watched = |listener| epoll.modify(listener, LISTENER, interest).is_ok();
        self.listener().is_some_and(watched)
    }

    /// Whether connections are accepted.
    pub(super) const fn is_open(&self) -> bool {
        matches!(self.claim, Some(Claim::Held(_)))
    }

    /// Accepts the next connection, if one is pending.
    pub(super) fn accept(&self) -> io::Result<Option<SeqPacket>> {
        self.listener().map_or(Ok(None), Listener::accept)
    }

    /// Pauses accepting. Otherwise the pending connection would wake the loop at once.
    pub(super) fn pause(&mut self, epoll: &Epoll) {
        if self.watch(epoll, Interest::NONE) {
            self.accept_again = Some(clock::now().after(ACCEPT_PAUSE));
        }
    }

    /// When to call [`resume`](Self::resume) and [`look`](Self::look).
    pub(super) fn deadline(&self) -> Option<Instant> {
        match self.claim.as_ref()? {
            Claim::Held(_) => self.accept_again,
            Claim::Offered(offer) => Some(offer.look_at),
        }
    }

    /// Resumes accepting once the pause is over.
    pub(super) fn resume(&mut self, epoll: &Epoll) {
        let over = self.accept_again.is_some_and(|again| clock::now() >= again);
        if self.is_open() && over {
            self.watch_again(epoll);
        }
    }

    /// Watches the listening socket again; later if that fails now.
    //= SM2-TRN-012
    fn watch_again(&mut self, epoll: &Epoll) {
        let is_watched = self.watch(epoll, Interest::READABLE);
        self.accept_again = (!is_watched).then(|| clock::now().after(ACCEPT_PAUSE));
    }

    /// Releases the lock and stops accepting connections.
    //= SM2-RES-009
    pub(super) fn offer(&mut self, epoll: &Epoll) {
        if self.adopted {
            warn!(
                "cannot hand over: the socket belongs to the process that created it (socket activation); \
                 restart this Manager instead"
            );
            return;
        }
        match self.claim.take() {
            Some(Claim::Held(endpoint)) => {
                info!("handing over");
                let now = clock::now();
                self.claim = Some(Claim::Offered(Offer {
                    socket: endpoint.hand_over(),
                    since: now,
                    look_at: now.after(LOOK),
                }));
                self.watch(epoll, Interest::NONE);
            }
            other => self.claim = other,
        }
    }

    /// Checks whether a successor is there. Takes the domain back if none has come in time.
    //= SM2-RES-009
    pub(super) fn look(&mut self, epoll: &Epoll) -> Found {
        let now = clock::now();
        match self.claim.take() {
            Some(Claim::Offered(offer)) if now >= offer.look_at => self.look_now(offer, now, epoll),
            other => {
                self.claim = other;
                Found::Nothing
            }
        }
    }

    fn look_now(&mut self, mut offer: Offer, now: Instant, epoll: &Epoll) -> Found {
        if offer.socket.is_replaced() {
            self.claim = Some(Claim::Offered(offer));
            return Found::Successor;
        }
        let mut found = Found::Nothing;
        offer.look_at = now.after(LOOK);
        if now >= offer.since.after(SUCCESSOR_TIMEOUT) {
            match offer.socket.reclaim() {
                Ok(endpoint) => {
                    info!("no successor has taken over: serving again");
                    self.claim = Some(Claim::Held(endpoint));
                    self.watch_again(epoll);
                    return Found::Nothing;
                }
                Err(not) => {
                    // Busy: a successor holds the lock and is about to replace the socket.
                    if !matches!(not.reason, DomainSocketError::Busy { .. }) {
                        warn!(reason = %not.reason, "cannot take the domain back yet");
                    }
                    offer.socket = not.socket;
                    offer.look_at = now.after(LOOK_LATE);
                }
            }
        } else if now >= offer.since.after(PRECEDENCE) {
            // Each time, because a standby may have greeted since the last time.
            found = Found::Unclaimed;
        }
        self.claim = Some(Claim::Offered(offer));
        found
    }
}
