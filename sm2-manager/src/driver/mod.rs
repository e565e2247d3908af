//! The loop that connects sockets with the Manager machine.

mod access;
mod door;
mod log_limit;
mod reload;
mod sessions;
mod shares;
mod shortage;

use sm2_proto::control::Limit;
use std::{
    collections::{BTreeSet, HashMap, VecDeque},
    io, mem,
    os::fd::{AsFd, OwnedFd},
    path::Path,
    sync::Arc,
    thread,
    time::Duration,
};

use nix::{libc, unistd::geteuid};
use sm2_io::{DomainSocket, Epoll, Event, Events, InspectedFd, Interest, clock, wait_readable};
use sm2_proto::{
    Instant, Machine, NodeId,
    limits::DATAGRAM_MAX,
    manager::{self, Input, Output},
};
use tracing::{debug, info, warn};

use self::{
    door::{Door, Found, LISTENER},
    log_limit::{LeftOut, LogLimit, Warning},
    reload::PolicyReload,
    shares::Shares,
};
use crate::{
    HandOver, Options, Outcome, PolicyReloader, RunError, StartError, Stopper,
    connection::Connection, handles::Handles, policy_file,
};

/// Tokens in the epoll set. Connections use their session number, which starts at 1.
const STOP: u64 = u64::MAX - 1;
const HAND_OVER: u64 = u64::MAX - 2;
const RELOAD: u64 = u64::MAX - 3;
/// The bit of a token that stands for the process of a session, not for its socket. Sessions have smaller numbers.
const PROCESS: u64 = 1 << 63;

/// How many connections are accepted, or datagrams read from one node, before other sockets are served.
const TURN: usize = 32;
/// How long the last frames of a closed connection are handled before other sockets are served. Its name is
/// free when all are handled.
const LAST_ROUND: Duration = Duration::from_millis(3);
/// The shortest and the longest pause after an error of waiting for events.
const WAIT_DELAYS: [Duration; 2] = [Duration::from_millis(1), Duration::from_secs(1)];
/// The pause after the kernel had no memory to read a socket.
const READ_PAUSE: Duration = Duration::from_millis(1);
/// How long sockets are served before the loop looks for new events. One datagram may exceed it.
const ROUND: Duration = Duration::from_micros(200);

/// The broker of a domain. It claims the socket when created and serves in [`run`](Manager::run).
#[derive(Debug)]
pub struct Manager {
    machine: manager::Manager,
    door: Door,
    epoll: Epoll,
    handles: Handles,
    connections: HashMap<NodeId, Connection>,
    shares: Shares,
    log: LogLimit,
    /// The delay after the last error of waiting for events.
    wait_delay: Duration,
    /// Whether a socket could not be read for want of memory since the last wait.
    is_short_of_memory: bool,
    last_session: u64,
    /// Nodes that turned out not to read their sockets while outputs were carried out.
    given_up: VecDeque<NodeId>,
    /// Nodes whose sockets accepted everything, where the machine waits for that.
    drained: BTreeSet<NodeId>,
    send_again: Option<Instant>,
    reload: PolicyReload,
    queue_bytes: usize,
    buffer: Vec<u8>,
}

impl Manager {
    /// Claims the socket at `path` and listens. Nodes can connect from now on; they are served once
    /// [`run`](Manager::run) is called.
    ///
    /// The domain belongs to this process. A child that is made by `fork(2)` afterwards does not keep the socket, so a
    /// program that goes to the background by `fork(2)` does that before.
    ///
    /// # Errors
    ///
    /// [`StartError::Limit`] if a limit is wrong; [`StartError::DomainSocket`] if another Manager holds the domain
    /// or the path cannot be used; [`StartError::Io`] if the process has no descriptors left.
    //= SM2-TRN-001, SM2-TRN-007
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
    //= SM2-TRN-007
    pub fn adopt(socket: OwnedFd, options: Options) -> Result<Self, StartError> {
        options.limits.check()?;
        let endpoint = options.bind_options().adopt(socket)?;
        let handles = Handles::new().map_err(StartError::io("make an eventfd"))?;
        Self::at(Door::new(endpoint, true), &options, &handles)
    }

    pub(crate) fn bind_with(
        path: &Path,
        options: &Options,
        handles: &Handles,
    ) -> Result<Self, StartError> {
        options.limits.check()?;
        // A Manager that cannot serve leaves the domain to others. The policy is read again under the lock.
        policy_file::check(path, options).map_err(StartError::Policy)?;
        let endpoint: DomainSocket = options.bind_options().acquire_at(path)?;
        Self::at(Door::new(endpoint, false), options, handles)
    }

    //= SM2-SES-007, SM2-LNK-002, SM2-ACC-012, SM2-ACC-017
    fn at(door: Door, options: &Options, handles: &Handles) -> Result<Self, StartError> {
        let access = policy_file::of_domain(door.path(), options).map_err(StartError::Policy)?;
        let epoll = Epoll::new().map_err(StartError::io("create an epoll set"))?;
        (door.add_to(&epoll))
            .and_then(|()| epoll.add(&*handles.stop, STOP, Interest::READABLE))
            .and_then(|()| epoll.add(&*handles.hand_over, HAND_OVER, Interest::READABLE))
            .and_then(|()| epoll.add(&*handles.reload, RELOAD, Interest::READABLE))
            .map_err(StartError::io("watch the socket"))?;
        // The secret must not be guessable: with it, a process could claim the links of others.
        let (epoch, secret) = random().map_err(StartError::io("get random numbers"))?;
        let machine = manager::Manager::new(epoch, secret, options.limits);
        let mut machine = machine.with_owner(geteuid().as_raw());
        if let Some(access) = access {
            info!(policy = %access.path.display(), "access rights are restricted");
            machine = machine.with_access_policy(access.policy);
        }
        Ok(Self {
            machine,
            door,
            epoll,
            handles: handles.clone(),
            connections: HashMap::new(),
            shares: Shares::default(),
            log: LogLimit::default(),
            wait_delay: Duration::ZERO,
            is_short_of_memory: false,
            last_session: 0,
            given_up: VecDeque::new(),
            drained: BTreeSet::new(),
            send_again: None,
            reload: PolicyReload::new(options),
            queue_bytes: options.limits.count(Limit::QueueBytes),
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

    /// Returns a handle that makes [`run`](Manager::run) read the access policy of the domain again.
    #[must_use]
    pub fn policy_reload(&self) -> PolicyReloader {
        self.handles.policy_reload()
    }

    /// Serves until a [`Stopper`] stops it, or until another Manager has taken over after
    /// [`HandOver::start`].
    ///
    /// # Errors
    ///
    /// [`RunError`] if the epoll set cannot be used at all; all connections are closed then. After any other
    /// error of waiting for events, this function tries again.
    pub fn run(mut self) -> Result<Outcome, RunError> {
        info!(path = %self.path().display(), "serving");
        let mut events = Events::with_capacity(256);
        loop {
            let result = self.epoll.wait(&mut events, self.timeout());
            self.waited(result).map_err(RunError)?;
            let mut ready: Vec<Event> = events.iter().collect();
            // Without events, the stopper is asked directly.
            let mut stopping =
                !self.wait_delay.is_zero() && self.handles.is_stopped().map_err(RunError)?;
            ready.retain(|event| match event.token {
                STOP => {
                    stopping = true;
                    false
                }
                HAND_OVER => {
                    self.handles.hand_over.drain();
                    // A standby among the pending connections is a possible successor.
                    self.accept_pending();
                    self.door.offer(&self.epoll);
                    false
                }
                RELOAD => {
                    self.handles.reload.drain();
                    self.reload.ask();
                    false
                }
                _ => true,
            });
            self.end_processes(&mut ready);
            self.serve_all(ready);
            if stopping {
                self.feed(Input::Shutdown);
                info!("stopped");
                return Ok(Outcome::Stopped);
            }
            self.feed(Input::Tick);
            self.reload_policy();
            self.sum_up_warnings();
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

    /// Handles the result of waiting for events. After an error that may pass, pauses for 1 ms, then for twice
    /// the time before, up to 1 s.
    fn waited(&mut self, result: io::Result<()>) -> io::Result<()> {
        let Err(error) = result else {
            self.wait_delay = Duration::ZERO;
            if mem::take(&mut self.is_short_of_memory) {
                // The sockets that could not be read are ready again at once.
                self.pause(READ_PAUSE);
            }
            return Ok(());
        };
        let useless = [libc::EBADF, libc::EFAULT, libc::EINVAL].map(Some);
        if useless.contains(&error.raw_os_error()) {
            return Err(error);
        }
        if self.log.may_write(Warning::NotWaited, clock::now()) {
            warn!(%error, "cannot wait for events: trying again");
        }
        self.wait_delay = (2 * self.wait_delay).clamp(WAIT_DELAYS[0], WAIT_DELAYS[1]);
        self.pause(self.wait_delay);
        Ok(())
    }

    /// Does nothing for a while, unless the stopper ends it.
    fn pause(&self, time: Duration) {
        if wait_readable(&[self.handles.stop.as_fd()], Some(time)).is_err() {
            thread::sleep(time);
        }
    }

    /// Writes how many warnings were left out of the log.
    fn sum_up_warnings(&mut self) {
        for LeftOut {
            warning,
            count,
            seconds,
        } in self.log.end_periods(clock::now())
        {
            warn!("{warning}: {count} more of these in the last {seconds} s");
        }
    }

    fn timeout(&self) -> Option<Duration> {
        let due = [
            self.machine.deadline(),
            self.door.deadline(),
            self.log.deadline(),
            self.send_again,
        ];
        let due = due.into_iter().flatten().min()?;
        Some(due.since(clock::now()))
    }

    /// Serves a round of the connections that have closed, and a round of the others. Nodes that are not
    /// welcomed wait until each closed connection had its turn: the closed ones free names (SM2-SES-003).
    //= SM2-SES-003
    fn serve_all(&mut self, ready: Vec<Event>) {
        let (gone, mut here): (Vec<Event>, Vec<Event>) =
            ready.into_iter().partition(|event| event.hangup);
        if !self.serve_round(gone) {
            here.retain(|event| self.machine.is_welcomed(NodeId(event.token)));
        }
        self.serve_round(here);
    }

    /// Serves sockets until the round is over. The next call of `epoll_wait` reports the others again.
    /// Returns whether all of them had their turn.
    //= SM2-SES-009
    fn serve_round(&mut self, mut ready: Vec<Event>) -> bool {
        ready.sort_by_key(|it| self.shares.start_tag(it.token));
        let mut left = ready.len();
        let mut before = clock::now();
        let until = before.after(ROUND);
        for event in ready {
            match event.token {
                LISTENER if self.door.is_open() => self.accept(until),
                LISTENER => {}
                token if event.hangup => self.serve(NodeId(token), event, before.after(LAST_ROUND)),
                token => self.serve(NodeId(token), event, until),
            }
            let now = clock::now();
            self.shares.charge(event.token, now.since(before));
            if event.token != LISTENER && !self.connections.contains_key(&NodeId(event.token)) {
                self.shares.forget(event.token);
            }
            left -= 1;
            if now >= until {
                break;
            }
            before = now;
        }
        left == 0
    }

    fn accept(&mut self, until: Instant) {
        for _ in 0..TURN {
            if clock::now() >= until {
                return;
            }
            match self.let_in() {
                Ok(Some(arrival)) => self.connect(arrival),
                Ok(None) => return,
                Err(error) if self.make_descriptors(&error) => self.report_sockets(),
                Err(error) => {
                    if self.log.may_write(Warning::NotAccepted, clock::now()) {
                        warn!(%error, "cannot accept a connection: raise the limit of open files (RLIMIT_NOFILE)");
                    }
                    return self.door.pause(&self.epoll);
                }
            }
        }
    }

    /// Says goodbye to every node because another Manager serves now. Pending connections are accepted first,
    /// so that they get the goodbye too.
    //= SM2-RES-009, SM2-SES-008
    fn leave(&mut self) {
        self.accept_pending();
        self.feed(Input::Shutdown);
        info!("handed over");
    }

    fn accept_pending(&mut self) {
        while let Ok(Some(arrival)) = self.let_in() {
            self.connect(arrival);
        }
    }

    /// Passes an input to the machine. All inputs go through here.
    fn feed(&mut self, input: Input<'_>) {
        self.feed_with(input, Vec::new());
    }

    /// As [`feed`](Self::feed), with the descriptors that were received. Descriptors that no output keeps are
    /// closed.
    fn feed_with(&mut self, input: Input<'_>, fds: Vec<InspectedFd>) {
        self.step(input, fds);
        self.report_sockets();
    }

    /// Tells the machine which nodes do not read their sockets, and which sockets have room again.
    fn report_sockets(&mut self) {
        while let Some(session) = self.given_up.pop_front() {
            self.step(Input::Stalled { session }, Vec::new());
        }
        //= SM2-LNK-006
        while let Some(session) = self.drained.pop_first() {
            let waiting = self.connections.get(&session).map(Connection::is_waiting);
            if waiting == Some(false) && self.machine.awaits_room(session) {
                self.step(Input::Drained { session }, Vec::new());
            }
        }
    }

    /// Handles one input and carries out every output. No other place matches the outputs.
    fn step(&mut self, input: Input<'_>, fds: Vec<InspectedFd>) {
        let mut fds = fds.into_iter().map(OwnedFd::from);
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
                        if self.log.may_write(Warning::NotLinked, clock::now()) {
                            warn!(%link, %error, "no socket pair for a link: raise the limit of open files");
                        }
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
                //= SM2-CNT-003
                Output::SendCounters { session, frame, of } => {
                    let owner = self.connections.get(&of);
                    let file = owner.and_then(|owner| owner.counters.clone());
                    self.send(session, frame, file);
                }
                //= SM2-ACC-016
                Output::ReadAccessPolicy => self.reload.ask(),
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
    let (mut epoch, mut secret) = ([0; 8], [0; 16]);
    getrandom::fill(&mut epoch)?;
    getrandom::fill(&mut secret)?;
    Ok((u64::from_ne_bytes(epoch), u128::from_ne_bytes(secret)))
}

#[cfg(test)]
mod tests;
