//! The loop: sockets on one side, the Manager machine on the other.

mod door;
mod sessions;
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

use self::door::{Door, Found, LISTENER};
use crate::{
    HandOver, Options, Outcome, RunError, StartError, Stopper, connection::Connection,
    handles::Handles,
};

/// Tokens of the epoll set; connections use their session's number, from 1 on.
const STOP: u64 = u64::MAX - 1;
const HAND_OVER: u64 = u64::MAX - 2;

/// How many connections are accepted, and datagrams read from one node, before others
/// have their turn.
const TURN: usize = 32;

/// A domain's broker. Claims the socket when made, serves in [`run`](Manager::run).
#[derive(Debug)]
pub struct Manager {
    machine: manager::Manager,
    door: Door,
    epoll: Epoll,
    handles: Handles,
    connections: HashMap<NodeId, Connection>,
    last_session: u64,
    /// Nodes that were found not to read while outputs were carried out.
    given_up: VecDeque<NodeId>,
    /// Nodes whose sockets took all that was sent to them, where the machine waits for that.
    drained: BTreeSet<NodeId>,
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
    /// [`StartError::DomainSocket`] if another Manager holds the domain, or the place is not
    /// fit; [`StartError::Io`] if descriptors ran out.
    //= SM2-TRN-001, SM2-TRN-008
    pub fn bind(path: &Path, options: Options) -> Result<Self, StartError> {
        let handles = Handles::new().map_err(StartError::io("make an eventfd"))?;
        Self::bind_with(path, &options, &handles)
    }

    /// Serves at a listening socket that somebody else has made and bound to a path: socket
    /// activation. Its file stays when this Manager ends, and with it those who connect until
    /// the next one serves there. Such a Manager does not hand over.
    ///
    /// # Errors
    ///
    /// As [`bind`](Self::bind), and if it is not a listening `AF_UNIX` `SOCK_SEQPACKET` socket
    /// with a path. The socket is closed then.
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
        let epoll = Epoll::new().map_err(StartError::io("make an epoll set"))?;
        (door.add_to(&epoll))
            .and_then(|()| epoll.add(&*handles.stop, STOP, Interest::READABLE))
            .and_then(|()| epoll.add(&*handles.hand_over, HAND_OVER, Interest::READABLE))
            .map_err(StartError::io("watch the socket"))?;
        // Whoever could guess the secret could claim the links of others.
        let (epoch, secret) = random().map_err(StartError::io("get random numbers"))?;
        Ok(Self {
            machine: manager::Manager::new(epoch, secret, options.policy),
            door,
            epoll,
            handles: handles.clone(),
            connections: HashMap::new(),
            last_session: 0,
            given_up: VecDeque::new(),
            drained: BTreeSet::new(),
            send_again: None,
            queue_bytes: options.queue_bytes,
            // One byte more than a datagram may have, so that a longer one shows.
            buffer: vec![0; DATAGRAM_MAX + 1],
        })
    }

    /// The socket's path.
    #[must_use]
    pub fn path(&self) -> &Path {
        self.door.path()
    }

    /// What ends [`run`](Manager::run).
    #[must_use]
    pub fn stopper(&self) -> Stopper {
        self.handles.stopper()
    }

    /// What makes [`run`](Manager::run) leave the domain to another Manager.
    #[must_use]
    pub fn hand_over(&self) -> HandOver {
        self.handles.hand_over()
    }

    /// Serves until a [`Stopper`] says so, or another Manager has taken over after
    /// [`HandOver::start`].
    ///
    /// # Errors
    ///
    /// [`RunError`] if the kernel does not let it wait; all connections are closed then.
    pub fn run(mut self) -> Result<Outcome, RunError> {
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
                    HAND_OVER => {
                        self.handles.hand_over.drain();
                        self.door.offer(&self.epoll);
                    }
                    LISTENER if self.door.is_open() => self.accept(),
                    LISTENER => {}
                    token => self.serve(NodeId(token), event),
                }
            }
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

    fn accept(&mut self) {
        for _ in 0..TURN {
            match self.let_in() {
                Ok(Some((socket, place))) => self.connect(socket, place),
                Ok(None) => return,
                Err(error) if self.make_descriptors(&error) => self.feed(Input::Tick),
                Err(error) => {
                    warn!(%error, "cannot accept a connection: raise the limit of open files");
                    return self.door.pause(&self.epoll);
                }
            }
        }
    }

    /// Says goodbye to everybody: there is another Manager now. Those who connected to this
    /// one and were not let in are told, too.
    //= SM2-RES-010, SM2-SES-008
    fn leave(&mut self) {
        while let Ok(Some((socket, place))) = self.let_in() {
            self.connect(socket, place);
        }
        self.feed(Input::Shutdown);
        info!("handed over");
    }

    /// The one way into the machine.
    fn feed(&mut self, input: Input<'_>) {
        self.feed_with(input, ReceivedFds::default());
    }

    /// The same, with the descriptors that came along. Those that nobody keeps are closed.
    fn feed_with(&mut self, input: Input<'_>, fds: ReceivedFds) {
        self.step(input, fds);
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

    /// The one place that carries out what the machine says.
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
                        // What comes of it, this loop does.
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

/// A number that no other Manager of this domain has used, and one that nobody knows.
fn random() -> io::Result<(u64, u128)> {
    let mut bytes = [[0; 8]; 3];
    getrandom::fill(bytes.as_flattened_mut())?;
    let [epoch, low, high] = bytes.map(u64::from_ne_bytes);
    Ok((epoch, u128::from(high) << 64 | u128::from(low)))
}
