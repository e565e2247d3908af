//! The loop: sockets on one side, the Manager machine on the other.

use std::{
    collections::{HashMap, VecDeque},
    hash::{BuildHasher, Hasher, RandomState},
    io,
    os::fd::AsFd,
    path::Path,
    sync::Arc,
    time::Duration,
};

use nix::libc;
use sm2_io::{
    Claim, Endpoint, EndpointError, Epoll, Event, Events, Interest, RecvError, SeqPacket, Waker,
    clock,
};
use sm2_proto::{
    Datagram, Farewell, FdFacts, Instant, NodeId,
    limits::DATAGRAM_MAX,
    manager::{Cause, Credentials, Input, Manager as Machine, Output, Policy},
};
use tracing::{debug, info, warn};

use crate::connection::{Connection, Lost, Sent};

/// How a Manager serves its domain.
#[derive(Clone, Copy, Debug)]
pub struct Options {
    /// Quotas, and when links are sealed.
    pub policy: Policy,
    /// How many bytes are kept for a node that does not read.
    pub queue_bytes: usize,
    /// The socket's permission bits: who may connect needs to write.
    pub socket_mode: u32,
}

impl Default for Options {
    fn default() -> Self {
        Self {
            policy: Policy::default(),
            queue_bytes: 1 << 20,
            socket_mode: 0o600,
        }
    }
}

/// Why a Manager did not start.
#[derive(Debug, thiserror::Error)]
pub enum StartError {
    /// The domain's socket cannot be claimed.
    #[error(transparent)]
    Endpoint(#[from] EndpointError),
    /// The operating system refused what every Manager needs.
    #[error("cannot {action}: {source}")]
    Io {
        /// What was tried.
        action: &'static str,
        /// What it said.
        source: io::Error,
    },
}

/// The loop cannot go on. Links live on without their Manager.
#[derive(Debug, thiserror::Error)]
#[error("the Manager cannot wait for events any more: {0}")]
pub struct RunError(#[from] io::Error);

/// Ends a Manager's loop, from any thread.
#[derive(Clone, Debug)]
pub struct Stopper(Arc<Waker>);

impl Stopper {
    /// Asks the loop to end. It says goodbye to every node and removes its socket.
    pub fn stop(&self) {
        self.0.wake();
    }
}

/// Tokens of the epoll set; connections use their session's number, from 1 on.
const LISTENER: u64 = u64::MAX;
const STOP: u64 = u64::MAX - 1;

/// How many connections are accepted, and datagrams read from one node, before others
/// have their turn.
const TURN: usize = 32;
/// How many descriptors may wait for one node while descriptors are short: what a node
/// that is busy for a moment needs.
const HOARD: usize = 64;
/// How many descriptors a node may have left unread while too many are in flight: what one
/// that is busy for a moment has.
const UNREAD: usize = 32;
/// After how long sending is tried again when too many descriptors are in flight.
const CROWDED_PAUSE: Duration = Duration::from_millis(10);
/// How long accepting pauses when the process has no descriptor to spare.
const ACCEPT_PAUSE: Duration = Duration::from_millis(100);

/// A domain's broker. Claims the socket when made, serves in [`run`](Manager::run).
#[derive(Debug)]
pub struct Manager {
    machine: Machine,
    endpoint: Endpoint,
    epoll: Epoll,
    stop: Arc<Waker>,
    connections: HashMap<NodeId, Connection>,
    last_session: u64,
    /// Nodes that were found not to read while outputs were carried out.
    given_up: VecDeque<NodeId>,
    accept_again: Option<Instant>,
    send_again: Option<Instant>,
    queue_bytes: usize,
    buffer: Vec<u8>,
}

impl Manager {
    /// Claims the socket at `path` and listens. Nodes can connect from now on; they are
    /// served once [`run`](Manager::run) is called.
    ///
    /// # Errors
    ///
    /// [`StartError::Endpoint`] if another Manager holds the domain, or the place is not
    /// fit; [`StartError::Io`] if descriptors ran out.
    //= SM2-TRN-001, SM2-TRN-008
    pub fn bind(path: &Path, options: Options) -> Result<Self, StartError> {
        let claim = Claim {
            mode: options.socket_mode,
            ..Claim::default()
        };
        let endpoint = claim.acquire_at(path)?;
        let failed = |action| move |source| StartError::Io { action, source };
        let epoll = Epoll::new().map_err(failed("make an epoll set"))?;
        let stop = Arc::new(Waker::new().map_err(failed("make an eventfd"))?);
        epoll
            .add(endpoint.listener(), LISTENER, Interest::READABLE)
            .and_then(|()| epoll.add(&*stop, STOP, Interest::READABLE))
            .map_err(failed("watch the socket"))?;
        Ok(Self {
            machine: Machine::new(fresh_epoch(), options.policy),
            endpoint,
            epoll,
            stop,
            connections: HashMap::new(),
            last_session: 0,
            given_up: VecDeque::new(),
            accept_again: None,
            send_again: None,
            queue_bytes: options.queue_bytes,
            // One byte more than a datagram may have, so that a longer one shows.
            buffer: vec![0; DATAGRAM_MAX + 1],
        })
    }

    /// The socket's path.
    #[must_use]
    pub fn path(&self) -> &Path {
        self.endpoint.path()
    }

    /// What ends [`run`](Manager::run).
    #[must_use]
    pub fn stopper(&self) -> Stopper {
        Stopper(Arc::clone(&self.stop))
    }

    /// Serves until a [`Stopper`] says so.
    ///
    /// # Errors
    ///
    /// [`RunError`] if the kernel does not let it wait; all connections are closed then.
    pub fn run(mut self) -> Result<(), RunError> {
        info!(path = %self.path().display(), "serving");
        let mut events = Events::with_capacity(256);
        loop {
            self.epoll.wait(&mut events, self.timeout())?;
            // Whoever is gone is heard first: its name is free for whoever comes
            // (SM2-SES-003), also when both happened since the last turn.
            //= SM2-SES-003
            let (gone, here): (Vec<Event>, Vec<Event>) =
                events.iter().partition(|event| event.hangup);
            let mut stopping = false;
            for event in gone.into_iter().chain(here) {
                match event.token {
                    STOP => stopping = true,
                    LISTENER => self.accept(),
                    token => self.serve(NodeId(token), event),
                }
            }
            if stopping {
                self.feed(Input::Shutdown);
                info!("stopped");
                return Ok(());
            }
            self.feed(Input::Tick);
            self.resume_accepting();
            self.resume_sending();
        }
    }

    fn timeout(&self) -> Option<Duration> {
        let due = [self.machine.deadline(), self.accept_again, self.send_again]
            .into_iter()
            .flatten()
            .min()?;
        Some(due.since(clock::now()))
    }

    fn accept(&mut self) {
        for _ in 0..TURN {
            match self.endpoint.listener().accept() {
                Ok(Some(socket)) => self.connect(socket),
                Ok(None) => return,
                Err(error) if self.make_descriptors(&error) => self.feed(Input::Tick),
                Err(error) => {
                    warn!(%error, "cannot accept a connection: raise the limit of open files");
                    // The connection stays in the queue, and would wake the loop at once.
                    let quiet =
                        self.epoll
                            .modify(self.endpoint.listener(), LISTENER, Interest::NONE);
                    if quiet.is_ok() {
                        self.accept_again = Some(clock::now().after(ACCEPT_PAUSE));
                    }
                    return;
                }
            }
        }
    }

    fn resume_accepting(&mut self) {
        if self.accept_again.is_some_and(|again| clock::now() >= again) {
            let listener = self.endpoint.listener();
            if self
                .epoll
                .modify(listener, LISTENER, Interest::READABLE)
                .is_ok()
            {
                self.accept_again = None;
            }
        }
    }

    fn resume_sending(&mut self) {
        if self.send_again.is_none_or(|again| clock::now() < again) {
            return;
        }
        self.send_again = None;
        let all = self.connections.iter();
        let waiting = all.filter(|(_, connection)| connection.is_waiting());
        let waiting: Vec<NodeId> = waiting.map(|(&session, _)| session).collect();
        for session in waiting {
            self.make_room(session);
        }
        self.feed(Input::Tick);
    }

    /// Descriptors in flight are counted for us, whoever does not take them. So whoever
    /// left most unread is given up, if it is much, and all others wait a moment.
    //= SM2-TRN-010
    fn crowded(&mut self) {
        self.send_again = Some(clock::now().after(CROWDED_PAUSE));
        let all = self.connections.iter_mut();
        let all = all.map(|(session, connection)| (connection.unread_fds(), session, connection));
        if let Some((unread, &session, deaf)) = all.max_by_key(|(unread, ..)| *unread)
            && unread > UNREAD
        {
            deaf.give_up();
            self.given_up.push_back(session);
        }
    }

    //= SM2-TRN-007
    fn connect(&mut self, socket: SeqPacket) {
        self.last_session += 1;
        let session = NodeId(self.last_session);
        let watched = self.epoll.add(&socket, session.0, Interest::READABLE);
        let peer = watched.and_then(|()| socket.peer_credentials());
        let peer = match peer {
            Ok(peer) => peer,
            Err(error) => return warn!(%error, "cannot serve a connection"),
        };
        debug!(%session, uid = peer.uid, pid = peer.pid, "connected");
        self.connections.insert(session, Connection::new(socket));
        let credentials = Credentials {
            uid: peer.uid,
            gid: peer.gid,
            pid: peer.pid,
        };
        self.feed(Input::Connected {
            session,
            credentials,
        });
    }

    fn serve(&mut self, session: NodeId, event: Event) {
        if event.writable {
            self.make_room(session);
            self.feed(Input::Tick);
        }
        // Whoever hung up is read to the end, which the kernel's buffer bounds.
        let turns = if event.hangup { usize::MAX } else { TURN };
        for _ in 0..turns {
            if !event.readable || !self.receive(session) {
                return;
            }
        }
    }

    /// Reads one datagram; whether there may be another.
    fn receive(&mut self, session: NodeId) -> bool {
        let Some(connection) = self.connections.get(&session) else {
            return false;
        };
        let mut buffer = std::mem::take(&mut self.buffer);
        let received = connection.socket.recv(&mut buffer);
        let go_on = match received {
            Ok(received) => {
                // No frame from a node carries a descriptor: their number is all that counts.
                let facts = vec![FdFacts::default(); received.fds.len()];
                let datagram = Datagram {
                    bytes: &buffer[..received.len],
                    fds: &facts,
                    data_truncated: received.data_truncated,
                    control_truncated: received.control_truncated,
                };
                self.feed(Input::Datagram { session, datagram });
                true
            }
            Err(RecvError::WouldBlock) => false,
            Err(RecvError::Closed) => {
                self.feed(Input::Closed { session });
                false
            }
            Err(RecvError::Io(error)) => {
                warn!(%session, %error, "cannot read from a node");
                self.feed(Input::Closed { session });
                false
            }
        };
        self.buffer = buffer;
        go_on
    }

    fn make_room(&mut self, session: NodeId) {
        let Some(connection) = self.connections.get_mut(&session) else {
            return;
        };
        let flushed = connection.flush();
        self.sent(session, flushed);
    }

    /// Watches a socket for room exactly as long as frames wait for that.
    fn sent(&mut self, session: NodeId, sent: Result<Sent, Lost>) {
        let interest = match sent {
            Ok(Sent::Taken) => Interest::READABLE,
            Ok(Sent::Full) => Interest::BOTH,
            Ok(Sent::Crowded) => {
                self.crowded();
                Interest::READABLE
            }
            // A closed socket is readable, and reading says what became of it.
            Err(Lost::Closed) => return,
            Err(Lost::Stalled) => return self.given_up.push_back(session),
        };
        if let Some(connection) = self.connections.get_mut(&session)
            && connection.interest != interest
        {
            connection.interest = interest;
            // Cannot fail for a socket that is in the set.
            let _ = self.epoll.modify(&connection.socket, session.0, interest);
        }
    }

    /// The one way into the machine, and the one place that carries out what it says.
    fn feed(&mut self, input: Input<'_>) {
        self.step(input);
        while let Some(session) = self.given_up.pop_front() {
            self.step(Input::Stalled { session });
        }
    }

    fn step(&mut self, input: Input<'_>) {
        if let Err(misuse) = self.machine.handle(clock::now(), input) {
            warn!(%misuse, "the driver broke the machine's contract");
        }
        while let Some(output) = self.machine.poll() {
            match output {
                Output::Send { session, frame } => self.send(session, frame, None),
                Output::Link { link, ends } => match self.pair() {
                    Ok((one, other)) => {
                        let [(a, to_a), (b, to_b)] = ends;
                        debug!(%link, %a, %b, "linked");
                        self.send(a, to_a, Some(one));
                        self.send(b, to_b, Some(other));
                    }
                    Err(error) => {
                        warn!(%link, %error, "no socket pair for a link: raise the limit of open files");
                        // Gives no output, so it does not come back here.
                        let _ = self
                            .machine
                            .handle(clock::now(), Input::LinkFailed { link });
                    }
                },
                Output::HangUp {
                    session,
                    goodbye,
                    cause,
                } => {
                    self.hang_up(session, goodbye, cause);
                }
            }
        }
    }

    fn pair(&mut self) -> io::Result<(SeqPacket, SeqPacket)> {
        loop {
            match SeqPacket::pair() {
                Err(error) if self.make_descriptors(&error) => {}
                result => return result,
            }
        }
    }

    /// Where descriptors ran out, gives up the node that makes us keep the most of them:
    /// one that does not read shall not keep others from being served. Whether there
    /// are more now.
    //= SM2-TRN-009
    fn make_descriptors(&mut self, error: &io::Error) -> bool {
        let short = [libc::EMFILE, libc::ENFILE].map(Some);
        if !short.contains(&error.raw_os_error()) {
            return false;
        }
        let all = self.connections.iter_mut();
        let most = all.max_by_key(|(_, connection)| connection.waiting_fds());
        let Some((&session, hoarder)) = most else {
            return false;
        };
        if hoarder.waiting_fds() <= HOARD {
            return false;
        }
        hoarder.give_up();
        self.given_up.push_back(session);
        true
    }

    //= SM2-LNK-001
    fn send(&mut self, session: NodeId, frame: Vec<u8>, link: Option<SeqPacket>) {
        let Some(connection) = self.connections.get_mut(&session) else {
            return;
        };
        let sent = connection.send(frame, link.map(Into::into), self.queue_bytes);
        self.sent(session, sent);
    }

    /// Where every session ends.
    fn hang_up(&mut self, session: NodeId, goodbye: Option<Vec<u8>>, cause: Cause) {
        match cause {
            Cause::Violation(rule) => {
                warn!(%session, rule = rule.name(), clause = rule.clause(), "hung up: the node broke the protocol");
            }
            Cause::Farewell(Farewell::ShuttingDown) => debug!(%session, "said goodbye"),
            Cause::Farewell(why) => warn!(%session, %why, clause = why.clause(), "hung up"),
            Cause::Goodbye(code) => debug!(%session, %code, "the node said goodbye"),
            Cause::Gone => debug!(%session, "the node is gone"),
        }
        let Some(connection) = self.connections.remove(&session) else {
            return;
        };
        // Closing takes it out of the set too, but only once nobody else holds the socket.
        let _ = self.epoll.remove(connection.socket.as_fd());
        connection.say_goodbye(goodbye);
    }
}

/// A number that no other Manager of this domain has used: 64 random bits.
//= SM2-SES-007
fn fresh_epoch() -> u64 {
    let mut hasher = RandomState::new().build_hasher();
    hasher.write_u64(clock::now().0);
    hasher.finish()
}
