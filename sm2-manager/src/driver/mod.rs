//! The loop that connects sockets with the Manager machine.

mod door;
mod sessions;
mod shares;
mod shortage;

use std::{
    collections::{BTreeSet, HashMap, VecDeque},
    io,
    os::fd::OwnedFd,
    path::Path,
    sync::Arc,
    time::Duration,
};

use sm2_io::{DomainSocket, Epoll, Event, Events, Interest, ReceivedFds, clock};
use sm2_proto::{
    Instant, Machine, NodeId,
    limits::DATAGRAM_MAX,
    manager::{self, Input, Output},
};
use tracing::{debug, info, warn};

use self::{
    door::{Door, Found, LISTENER},
    shares::Shares,
};
use crate::{
    HandOver, Options, Outcome, RunError, StartError, Stopper, connection::Connection,
    handles::Handles,
};

/// Tokens in the epoll set. Connections use their session number, which starts at 1.
const STOP: u64 = u64::MAX - 1;
const HAND_OVER: u64 = u64::MAX - 2;

/// How many connections are accepted, or datagrams read from one node, before other sockets are served.
const TURN: usize = 32;
/// How long sockets are served before the loop looks for new events. One datagram may exceed it.
const ROUND: Duration = Duration::from_micros(500);

/// The broker of a domain. It claims the socket when created and serves in [`run`](Manager::run).
#[derive(Debug)]
pub struct Manager {
    machine: manager::Manager,
    door: Door,
    epoll: Epoll,
    handles: Handles,
    connections: HashMap<NodeId, Connection>,
    shares: Shares,
    last_session: u64,
    /// Nodes that turned out not to read their sockets while outputs were carried out.
    given_up: VecDeque<NodeId>,
    /// Nodes whose sockets accepted everything, where the machine waits for that.
    drained: BTreeSet<NodeId>,
    send_again: Option<Instant>,
    queue_bytes: usize,
    buffer: Vec<u8>,
}

impl Manager {
    /// Claims the socket at `path` and listens. Nodes can connect from now on; they are served once
    /// [`run`](Manager::run) is called.
    ///
    /// # Errors
    ///
    /// [`StartError::DomainSocket`] if another Manager holds the domain or the path cannot be used;
    /// [`StartError::Io`] if the process has no descriptors left.
    //= SM2-TRN-001, SM2-TRN-008
    pub fn bind(path: &Path, options: Options) -> Result<Self, StartError> {
        let handles = Handles::new().map_err(StartError::io("make an eventfd"))?;
        Self::bind_with(path, &options, &handles)
    }

    /// Serves on a listening socket that another process created and bound (socket activation). When this
    /// Manager ends, the socket file stays, and pending connections wait for the next Manager. Such a Manager
    /// cannot hand over.
    ///
    /// # Errors
    ///
    /// As for [`bind`](Self::bind); also if `socket` is not a listening `AF_UNIX` `SOCK_SEQPACKET` socket
    /// with a path. In that case the socket is closed.
    //= SM2-TRN-008
    pub fn adopt(socket: OwnedFd, options: Options) -> Result<Self, StartError> {
        let endpoint = options.bind_options().adopt(socket)?;
        let handles = Handles::new().map_err(StartError::io("make an eventfd"))?;
        Self::at(Door::new(endpoint, true), &options, &handles)
    }

    pub(crate) fn bind_with(
        path: &Path,
        options: &Options,
        handles: &Handles,
    ) -> Result<Self, StartError> {
        let endpoint: DomainSocket = options.bind_options().acquire_at(path)?;
        Self::at(Door::new(endpoint, false), options, handles)
    }

    //= SM2-SES-007, SM2-LNK-002
    fn at(door: Door, options: &Options, handles: &Handles) -> Result<Self, StartError> {
        let epoll = Epoll::new().map_err(StartError::io("create an epoll set"))?;
        (door.add_to(&epoll))
            .and_then(|()| epoll.add(&*handles.stop, STOP, Interest::READABLE))
            .and_then(|()| epoll.add(&*handles.hand_over, HAND_OVER, Interest::READABLE))
            .map_err(StartError::io("watch the socket"))?;
        // The secret must not be guessable: with it, a process could claim the links of others.
        let (epoch, secret) = random().map_err(StartError::io("get random numbers"))?;
        Ok(Self {
            machine: manager::Manager::new(epoch, secret, options.policy),
            door,
            epoll,
            handles: handles.clone(),
            connections: HashMap::new(),
            shares: Shares::default(),
            last_session: 0,
            given_up: VecDeque::new(),
            drained: BTreeSet::new(),
            send_again: None,
            queue_bytes: options.queue_bytes,
            // One byte more than the longest datagram, so that a longer one is noticed.
            buffer: vec![0; DATAGRAM_MAX + 1],
        })
    }

    /// The socket's path.
    #[must_use]
    pub fn path(&self) -> &Path {
        self.door.path()
    }

    /// Returns a handle that stops [`run`](Manager::run).
    #[must_use]
    pub fn stopper(&self) -> Stopper {
        self.handles.stopper()
    }

    /// Returns a handle that makes [`run`](Manager::run) hand over the domain to another Manager.
    #[must_use]
    pub fn hand_over(&self) -> HandOver {
        self.handles.hand_over()
    }

    /// Serves until a [`Stopper`] stops it, or until another Manager has taken over after
    /// [`HandOver::start`].
    ///
    /// # Errors
    ///
    /// [`RunError`] if waiting for events fails; all connections are closed then.
    pub fn run(mut self) -> Result<Outcome, RunError> {
        info!(path = %self.path().display(), "serving");
        let mut events = Events::with_capacity(256);
        loop {
            self.epoll.wait(&mut events, self.timeout())?;
            let mut ready: Vec<Event> = events.iter().collect();
            let mut stopping = false;
            ready.retain(|event| match event.token {
                STOP => {
                    stopping = true;
                    false
                }
                HAND_OVER => {
                    self.handles.hand_over.drain();
                    self.door.offer(&self.epoll);
                    false
                }
                _ => true,
            });
            self.serve_all(ready);
            if stopping {
                self.feed(Input::Shutdown);
                info!("stopped");
                return Ok(Outcome::Stopped);
            }
            self.feed(Input::Tick);
            self.door.resume(&self.epoll);
            self.resume_sending();
            match self.door.look(&self.epoll) {
                Found::Nothing => {}
                Found::Unclaimed => self.feed(Input::DismissStandbys),
                Found::Successor => {
                    self.leave();
                    return Ok(Outcome::HandedOver);
                }
            }
        }
    }

    fn timeout(&self) -> Option<Duration> {
        let due = [
            self.machine.deadline(),
            self.door.deadline(),
            self.send_again,
        ];
        let due = due.into_iter().flatten().min()?;
        Some(due.since(clock::now()))
    }

    /// Serves sockets until the round is over. The next call of `epoll_wait` reports the others again.
    //= SM2-SES-009, SM2-SES-003
    fn serve_all(&mut self, mut ready: Vec<Event>) {
        // Hang-ups come before other events of the same share: they free names for the nodes that connect.
        ready.sort_by_key(|it| (self.shares.start_tag(it.token), !it.hangup));
        let mut before = clock::now();
        let until = before.after(ROUND);
        for event in ready {
            match event.token {
                LISTENER if self.door.is_open() => self.accept(until),
                LISTENER => continue,
                token => self.serve(NodeId(token), event, until),
            }
            let now = clock::now();
            self.shares.charge(event.token, now.since(before));
            if event.token != LISTENER && !self.connections.contains_key(&NodeId(event.token)) {
                self.shares.forget(event.token);
            }
            if now >= until {
                return;
            }
            before = now;
        }
    }

    fn accept(&mut self, until: Instant) {
        for _ in 0..TURN {
            if clock::now() >= until {
                return;
            }
            match self.let_in() {
                Ok(Some((socket, place))) => self.connect(socket, place),
                Ok(None) => return,
                Err(error) if self.make_descriptors(&error) => self.report_sockets(),
                Err(error) => {
                    warn!(%error, "cannot accept a connection: raise the limit of open files (RLIMIT_NOFILE)");
                    return self.door.pause(&self.epoll);
                }
            }
        }
    }

    /// Says goodbye to every node because another Manager serves now. Pending connections are accepted first,
    /// so that they get the goodbye too.
    //= SM2-RES-010, SM2-SES-008
    fn leave(&mut self) {
        while let Ok(Some((socket, place))) = self.let_in() {
            self.connect(socket, place);
        }
        self.feed(Input::Shutdown);
        info!("handed over");
    }

    /// Passes an input to the machine. All inputs go through here.
    fn feed(&mut self, input: Input<'_>) {
        self.feed_with(input, ReceivedFds::default());
    }

    /// As [`feed`](Self::feed), with the descriptors that were received. Descriptors that no output keeps are
    /// closed.
    fn feed_with(&mut self, input: Input<'_>, fds: ReceivedFds) {
        self.step(input, fds);
        self.report_sockets();
    }

    /// Tells the machine which nodes do not read their sockets, and which sockets have room again.
    fn report_sockets(&mut self) {
        while let Some(session) = self.given_up.pop_front() {
            self.step(Input::Stalled { session }, ReceivedFds::default());
        }
        //= SM2-LNK-007
        while let Some(session) = self.drained.pop_first() {
            let waiting = self.connections.get(&session).map(Connection::is_waiting);
            if waiting == Some(false) && self.machine.awaits_room(session) {
                self.step(Input::Drained { session }, ReceivedFds::default());
            }
        }
    }

    /// Handles one input and carries out every output. No other place matches the outputs.
    fn step(&mut self, input: Input<'_>, fds: ReceivedFds) {
        let mut fds = fds.into_iter();
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
                        self.send(a, to_a, Some(Arc::new(one.into())));
                        self.send(b, to_b, Some(Arc::new(other.into())));
                    }
                    Err(error) => {
                        warn!(%link, %error, "no socket pair for a link: raise the limit of open files");
                        // This loop also drains the resulting outputs.
                        let failed = Input::LinkFailed { link };
                        let _ = self.machine.handle(clock::now(), failed);
                    }
                },
                //= SM2-CNT-001
                Output::KeepCounters { session } => {
                    if let Some(connection) = self.connections.get_mut(&session) {
                        connection.counters = fds.next().map(Arc::new);
                    }
                }
                //= SM2-CNT-002
                Output::SendCounters { session, frame, of } => {
                    let owner = self.connections.get(&of);
                    let file = owner.and_then(|owner| owner.counters.clone());
                    self.send(session, frame, file);
                }
                Output::HangUp {
                    session,
                    goodbye,
                    cause,
                } => self.hang_up(session, goodbye, cause),
            }
        }
    }
}

/// Returns an epoch that no other Manager of this domain has used, and a secret.
fn random() -> io::Result<(u64, u128)> {
    let mut bytes = [[0; 8]; 3];
    getrandom::fill(bytes.as_flattened_mut())?;
    let [epoch, low, high] = bytes.map(u64::from_ne_bytes);
    Ok((epoch, u128::from(high) << 64 | u128::from(low)))
}
