//! A Manager with an event loop of its own: `own_loop [SOCKET]`.
//!
//! Drives [`sm2_proto::manager::Manager`] without the loop of `sm2_manager` and without epoll: `poll(2)`, a
//! map and a few queues are enough. To nodes, this program and `sm2 manager` are the same:
//!
//! ```sh
//! cargo run -p sm2-manager --example own_loop
//! cargo run -p sm2-node --example listener
//! cargo run -p sm2-node --example talker
//! ```
//!
//! The duties of a loop that drives the machine, and where this example fulfils them:
//!
//! | duty | here |
//! | --- | --- |
//! | number the connections, pass their credentials and their datagrams | `accept`, `receive` |
//! | carry out all outputs after each input | `step`, and only there |
//! | call the machine with `Tick` at its deadline | `turn` |
//! | leave the next frames of a busy session in its socket | `may_read` |
//! | report that a socket accepted everything, if the machine waits for that | `feed` |
//! | queue frames that a socket does not accept; give up a node that does not read | `node.rs`, `note` |
//! | answer a wish to read the access policy again | `feed` |
//! | continue during a shortage of descriptors | `short`, `LinkFailed` |
//!
//! Sockets and the lock of the path come from sm2-io: nix returns descriptors from `accept4` and `recvmsg` as
//! numbers, and turning a number into an owned descriptor needs `unsafe`.
//!
//! Ctrl-C ends the program with status 0. It says goodbye to its nodes; their links stay open.

mod node;

use sm2_proto::control::Limits;
use std::collections::BTreeMap;
use std::error::Error;
use std::io::{self, Write};
use std::os::fd::{AsFd, OwnedFd};
use std::process::ExitCode;
use std::{mem, rc::Rc, time::Duration};

use nix::errno::Errno;
use nix::poll::{PollFd, PollFlags, ppoll};
use nix::sys::signal::{SigSet, Signal};
use nix::sys::{signalfd::SignalFd, time::TimeSpec};
use sm2_io::{BindOptions, DomainSocket, RecvError, SeqPacket, clock, memfd};
use sm2_proto::limits::DATAGRAM_MAX;
use sm2_proto::manager::{Cause, Credentials, Input, Manager, Output};
use sm2_proto::{Datagram, FdFacts, Instant, Machine, NodeId};

use node::{Node, Sent};

/// How many descriptors a node may leave unread while too many are in flight (SM2-TRN-009).
const UNTAKEN: usize = 64;
/// How many datagrams of one node are read before other nodes are served.
const TURN: usize = 32;
/// The delay before another attempt after a shortage of descriptors.
const PAUSE: Duration = Duration::from_millis(10);

fn main() -> ExitCode {
    match serve() {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("own_loop: {error}");
            ExitCode::FAILURE
        }
    }
}

fn serve() -> Result<(), Box<dyn Error>> {
    let mut mask = SigSet::empty();
    mask.add(Signal::SIGINT);
    mask.thread_block()?;
    let interrupts = SignalFd::new(&mask)?;
    let path = match std::env::args_os().nth(1) {
        Some(path) => path.into(),
        None => sm2_io::socket_path(None)?,
    };
    let mut broker = Broker::new(BindOptions::acquire(&path)?)?;
    say(format_args!("serving {}", path.display()));
    while broker.turn(&interrupts)? {}
    broker.feed(Input::Shutdown);
    Ok(())
}

struct Broker {
    machine: Manager,
    endpoint: DomainSocket,
    nodes: BTreeMap<NodeId, Node>,
    last_session: u64,
    /// Nodes that turned out not to read while outputs were carried out.
    stalled: Vec<NodeId>,
    /// Nodes whose sockets accepted everything, where the machine waits for that.
    drained: Vec<NodeId>,
    /// Descriptors of the datagram that is being handled.
    came: Vec<OwnedFd>,
    /// Whether a node asked for the access policy to be read again.
    policy_wanted: bool,
    /// End of a pause after a shortage of descriptors. Until then, nothing is accepted or sent from a queue.
    again: Option<Instant>,
}

impl Broker {
    fn new(endpoint: DomainSocket) -> io::Result<Self> {
        let (mut epoch, mut secret) = ([0; 8], [0; 16]);
        getrandom::fill(&mut epoch)?;
        getrandom::fill(&mut secret)?;
        let (epoch, secret) = (u64::from_ne_bytes(epoch), u128::from_ne_bytes(secret));
        Ok(Self {
            machine: Manager::new(epoch, secret, Limits::default()),
            endpoint,
            nodes: BTreeMap::new(),
            last_session: 0,
            stalled: Vec::new(),
            drained: Vec::new(),
            came: Vec::new(),
            policy_wanted: false,
            again: None,
        })
    }

    /// Waits for events and handles them. Returns whether the loop continues.
    fn turn(&mut self, interrupts: &SignalFd) -> Result<bool, Box<dyn Error>> {
        let wanted = |wanted, flags| if wanted { flags } else { PollFlags::empty() };
        let open = self.again.is_none();
        let listener = wanted(open, PollFlags::POLLIN);
        let mut fds = vec![
            PollFd::new(interrupts.as_fd(), PollFlags::POLLIN),
            PollFd::new(self.endpoint.listener().as_fd(), listener),
        ];
        fds.extend(self.nodes.values().map(|node| {
            let room = wanted(open && node.is_waiting(), PollFlags::POLLOUT);
            PollFd::new(node.socket.as_fd(), PollFlags::POLLIN | room)
        }));
        let due = [self.machine.deadline(), self.again];
        let due = due.into_iter().flatten().min();
        let timeout = due.map(|due| TimeSpec::from_duration(due.since(clock::now())));
        match ppoll(&mut fds, timeout, None) {
            Err(Errno::EINTR) => return Ok(true),
            result => result?,
        };
        let mut found = fds
            .iter()
            .map(|fd| fd.revents().unwrap_or(PollFlags::all()));
        let interrupted = found.next() != Some(PollFlags::empty());
        let knocking = found.next() != Some(PollFlags::empty());
        let ready: Vec<_> = self.nodes.keys().copied().zip(found).collect();

        // Hang-ups come first, because they free names for new nodes (SM2-SES-003). They are read to the end;
        // the kernel's buffer bounds how much that is.
        let gone = |flags: PollFlags| flags.intersects(PollFlags::POLLHUP | PollFlags::POLLERR);
        for &(session, _) in ready.iter().filter(|(_, flags)| gone(*flags)) {
            while self.may_read(session) && self.receive(session) {}
        }
        for &(session, flags) in ready.iter().filter(|(_, flags)| !gone(*flags)) {
            if flags.contains(PollFlags::POLLOUT) {
                let sent = self.nodes.get_mut(&session).map(Node::flush);
                self.note(session, sent);
            }
            if flags.contains(PollFlags::POLLIN) {
                (0..TURN).all(|_| self.may_read(session) && self.receive(session));
            }
        }
        if knocking {
            self.accept();
        }
        if self.again.is_some_and(|again| again <= clock::now()) {
            self.again = None;
        }
        self.feed(Input::Tick);
        Ok(!interrupted)
    }

    fn accept(&mut self) {
        let accepted = self.endpoint.listener().accept();
        let socket = match accepted {
            Ok(Some(socket)) => socket,
            Ok(None) => return,
            Err(error) => {
                say(format_args!("cannot accept a connection: {error}"));
                return self.short();
            }
        };
        let peer = match socket.peer_credentials() {
            Ok(peer) => peer,
            Err(error) => return say(format_args!("a connection without credentials: {error}")),
        };
        self.last_session += 1;
        let session = NodeId(self.last_session);
        self.nodes.insert(session, Node::new(socket));
        say(format_args!("{session} is process {}", peer.pid));
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

    /// Whether the machine has finished the work of the session's last frame. Until then the next frames stay
    /// in the socket (SM2-SES-009).
    fn may_read(&self, session: NodeId) -> bool {
        !self.machine.is_busy(session)
    }

    /// Passes one datagram to the machine. Returns whether there may be another one.
    fn receive(&mut self, session: NodeId) -> bool {
        let Some(node) = self.nodes.get(&session) else {
            return false;
        };
        // One byte more than the longest datagram, so that a longer one is noticed.
        let mut buffer = [0; DATAGRAM_MAX + 1];
        let received = match node.socket.recv(&mut buffer) {
            Ok(received) => received,
            Err(RecvError::WouldBlock) => return false,
            Err(RecvError::Closed | RecvError::Io(_)) => {
                self.feed(Input::Closed { session });
                return false;
            }
        };
        // A descriptor without facts is refused by the machine.
        let facts = |fd: &OwnedFd| memfd::facts(fd.as_fd()).unwrap_or_default();
        let facts: Vec<FdFacts> = received.fds.iter().map(facts).collect();
        self.came = received.fds.into_vec();
        let datagram = Datagram {
            bytes: &buffer[..received.len],
            fds: &facts,
            data_truncated: received.data_truncated,
            control_truncated: received.control_truncated,
        };
        self.feed(Input::Datagram { session, datagram });
        self.came.clear();
        true
    }

    fn feed(&mut self, input: Input<'_>) {
        self.step(input);
        if mem::take(&mut self.policy_wanted) {
            // The domain of this loop never has one.
            self.step(Input::SetAccessPolicy(None));
        }
        while let Some(session) = self.stalled.pop() {
            self.step(Input::Stalled { session });
        }
        while let Some(session) = self.drained.pop() {
            let waiting = self.nodes.get(&session).map(Node::is_waiting);
            if waiting == Some(false) && self.machine.awaits_room(session) {
                self.step(Input::Drained { session });
            }
        }
    }

    /// Handles one input and carries out all outputs. No other place matches the outputs.
    fn step(&mut self, input: Input<'_>) {
        if let Err(misuse) = self.machine.handle(clock::now(), input) {
            say(format_args!("this loop has a bug: {misuse}"));
        }
        while let Some(output) = self.machine.poll() {
            match output {
                Output::Send { session, frame } => self.send(session, frame, None),
                Output::Link { link, ends } => match SeqPacket::pair() {
                    Ok((one, other)) => {
                        let [(a, to_a), (b, to_b)] = ends;
                        say(format_args!("{link} joins {a} and {b}"));
                        self.send(a, to_a, Some(Rc::new(one.into())));
                        self.send(b, to_b, Some(Rc::new(other.into())));
                    }
                    Err(error) => {
                        say(format_args!("{link} was not made: {error}"));
                        self.short();
                        // The only input that is allowed before all outputs are drained.
                        let _ = (self.machine).handle(clock::now(), Input::LinkFailed { link });
                    }
                },
                Output::KeepCounters { session } => {
                    if let Some(node) = self.nodes.get_mut(&session) {
                        node.counters = self.came.pop().map(Rc::new);
                    }
                }
                Output::SendCounters { session, frame, of } => {
                    let counters = self.nodes.get(&of).and_then(|node| node.counters.clone());
                    self.send(session, frame, counters);
                }
                Output::ReadAccessPolicy => self.policy_wanted = true,
                Output::HangUp {
                    session,
                    goodbye,
                    cause,
                } => self.hang_up(session, goodbye, cause),
            }
        }
    }

    fn hang_up(&mut self, session: NodeId, goodbye: Option<Vec<u8>>, cause: Cause) {
        match cause {
            Cause::Violation(rule) => say(format_args!("{session} broke the protocol: {rule}")),
            Cause::Gone => say(format_args!("{session} is gone")),
            Cause::Goodbye(code) => say(format_args!("{session} said goodbye: {code}")),
            Cause::Farewell(why) => say(format_args!("{session} was told to go: {why}")),
        }
        if let Some(node) = self.nodes.remove(&session) {
            node.close(goodbye);
        }
    }

    fn send(&mut self, session: NodeId, frame: Vec<u8>, fd: Option<Rc<OwnedFd>>) {
        let node = self.nodes.get_mut(&session);
        let sent = node.map(|node| node.send(frame, fd));
        self.note(session, sent);
    }

    fn note(&mut self, session: NodeId, sent: Option<Sent>) {
        match sent {
            Some(Sent::Well) if self.machine.awaits_room(session) => self.drained.push(session),
            Some(Sent::Well) | None => {}
            Some(Sent::Crowded) => self.short(),
            Some(Sent::Stalled) => self.stalled.push(session),
        }
    }

    /// Handles a shortage of descriptors: pauses sending, and gives up the node that left the most
    /// descriptors unread, if these are many.
    fn short(&mut self) {
        self.again = Some(clock::now().after(PAUSE));
        let nodes = self.nodes.iter_mut();
        let nodes = nodes.map(|(&session, node)| (node.untaken_fds(), session));
        if let Some((untaken, session)) = nodes.max()
            && untaken > UNTAKEN
        {
            self.stalled.push(session);
        }
    }
}

/// Prints a line. A closed standard output is not a reason to end.
fn say(line: std::fmt::Arguments<'_>) {
    let _ = writeln!(io::stdout(), "{line}");
}
