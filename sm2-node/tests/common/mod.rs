//! A domain for each test.
#![allow(dead_code, reason = "each test uses its own part")]

pub(crate) mod fixture;
pub(crate) mod limit;
pub(crate) mod periods;
pub(crate) mod raw;
pub(crate) mod threads;
pub(crate) mod wait;

use sm2_proto::control::Limits;
use sm2_proto::limits::CELL_MAX;
use std::thread;
use std::time::{Duration, Instant};

use nix::sys::signal::{Signal, kill};
use nix::sys::wait::{WaitPidFlag, WaitStatus, waitpid};
use nix::unistd::Pid;
use sm2_manager::{Background, Options};
use sm2_node::diagnostics::LinkStatus;
use sm2_node::{
    Client, Message, Node, NodeBuilder, Publisher, Request, Sample, Server, Subscriber, Wait,
};
pub(crate) use sm2_test_support::SOON;

use self::limit::Limit;

/// With and without the ring lane.
pub(crate) const LANES: [bool; 2] = [true, false];
/// All ways to wait.
pub(crate) const WAYS: [Wait; 3] = [
    Wait::Park,
    Wait::SpinThenPark(Duration::from_micros(30)),
    Wait::Spin,
];

/// A Manager with its socket in a temporary directory.
pub(crate) struct Domain {
    manager: Option<Background>,
    folder: tempfile::TempDir,
    limits: Limits,
    _limit: Limit,
}

impl Domain {
    pub(crate) fn new() -> Self {
        Self::with(Limits::default())
    }

    pub(crate) fn with(limits: Limits) -> Self {
        let mut domain = Self {
            manager: None,
            folder: tempfile::tempdir().unwrap(),
            limits,
            _limit: Limit::new(),
        };
        domain.start();
        domain
    }

    pub(crate) fn socket(&self) -> std::path::PathBuf {
        self.folder.path().join("test.sock")
    }

    /// The options of a node that waits for its Manager as long as a busy machine may need.
    pub(crate) fn builder(&self, name: &str) -> NodeBuilder {
        let builder = Node::builder(name).socket(self.socket());
        builder.manager_timeout(SOON)
    }

    pub(crate) fn node(&self, name: &str) -> Node {
        self.builder(name).connect().unwrap()
    }

    /// Connects a node that offers the ring lane, or not.
    pub(crate) fn node_on(&self, ring: bool, name: &str) -> Node {
        self.builder(name).ring_lane(ring).connect().unwrap()
    }

    /// Starts a Manager. Existing nodes reconnect by themselves when they are called.
    pub(crate) fn start(&mut self) {
        assert!(self.manager.is_none());
        let options = Options {
            limits: self.limits,
            ..Options::default()
        };
        self.manager = Some(Background::start(&self.socket(), options).unwrap());
    }

    /// Stops the Manager. Nodes continue without it.
    pub(crate) fn stop(&mut self) {
        self.manager.take().unwrap().stop().unwrap();
    }
}

/// Whether links use the ring lane. All tests pass with and without it.
pub(crate) fn ring_lane() -> bool {
    std::env::var_os("SM2_RING_LANE").is_none_or(|it| it != "off")
}

/// Waits until each of these nodes knows that its Manager has ended.
pub(crate) fn away(nodes: &[&Node]) {
    until(|| nodes.iter().all(|node| !node.is_connected()));
}

/// Waits until each of these nodes is connected again, and the Manager has their claims: before that, it
/// makes no link with them. The nodes belong to one thread, so each must be called.
pub(crate) fn back(nodes: &[&Node]) {
    until(|| {
        // Calls every node, because the call drives it.
        nodes.iter().filter(|node| !node.is_connected()).count() == 0
    });
    until(|| {
        let domain = nodes[0].snapshot().unwrap();
        domain.nodes().all(|node| !node.resuming)
    });
}

/// Calls `is_so` repeatedly until it returns true.
pub(crate) fn until(mut is_so: impl FnMut() -> bool) {
    let deadline = Instant::now() + SOON;
    while !is_so() {
        assert!(Instant::now() < deadline, "waited in vain");
        thread::sleep(Duration::from_micros(100));
    }
}

/// Returns a message that begins with these bytes and is too long for a cell: it is in a slot until it is released.
pub(crate) fn in_slot(bytes: &[u8]) -> Vec<u8> {
    let mut message = bytes.to_vec();
    message.resize(message.len().max(CELL_MAX + 1), 0);
    message
}

/// As [`in_slot`], for a message of numbers: it repeats this one.
pub(crate) const fn number_in_slot(number: u64) -> [u64; CELL_MAX / 8 + 1] {
    [number; CELL_MAX / 8 + 1]
}

/// Returns bytes that depend on the position and on the message.
pub(crate) fn pattern(len: usize, seed: u64) -> Vec<u8> {
    let mut state = seed.wrapping_mul(0x9e37_79b9_7f4a_7c15) | 1;
    let mut bytes = vec![0; len.next_multiple_of(8)];
    // Word by word, because tests make long messages without optimization.
    for word in bytes.chunks_exact_mut(8) {
        state ^= state << 13;
        state ^= state >> 7;
        state ^= state << 17;
        word.copy_from_slice(&state.to_le_bytes());
    }
    bytes.truncate(len);
    bytes
}

/// Returns a linked publisher and subscriber of two nodes.
pub(crate) fn pair<T: Message + ?Sized>(
    domain: &Domain,
    publisher: impl FnOnce(&Node) -> Publisher<T>,
    subscriber: impl FnOnce(&Node) -> Subscriber<T>,
) -> (Publisher<T>, Subscriber<T>) {
    let publisher = publisher(&domain.node("talker"));
    let subscriber = subscriber(&domain.node("listener"));
    assert_eq!(subscriber.matched(), 1);
    meet(&publisher, &[&subscriber]);
    (publisher, subscriber)
}

/// One end of a topic, independent of its type.
pub(crate) trait Endpoint {
    fn links(&self) -> Vec<LinkStatus>;
}

impl<T: Message + ?Sized> Endpoint for Publisher<T> {
    fn links(&self) -> Vec<LinkStatus> {
        Publisher::links(self)
    }
}

impl<T: Message + ?Sized> Endpoint for Subscriber<T> {
    fn links(&self) -> Vec<LinkStatus> {
        Subscriber::links(self)
    }
}

impl<Q: Message + ?Sized, R: Message + ?Sized> Endpoint for Client<Q, R> {
    fn links(&self) -> Vec<LinkStatus> {
        Client::links(self)
    }
}

impl<Q: Message + ?Sized, R: Message + ?Sized> Endpoint for Server<Q, R> {
    fn links(&self) -> Vec<LinkStatus> {
        Server::links(self)
    }
}

/// Drives several nodes of one thread until all their links are open.
pub(crate) fn meet(publisher: &dyn Endpoint, subscribers: &[&dyn Endpoint]) {
    let deadline = Instant::now() + SOON;
    let open = |end: &dyn Endpoint| end.links().iter().filter(|link| link.open).count();
    loop {
        let counts: Vec<_> = subscribers.iter().map(|it| open(*it)).collect();
        if open(publisher) == subscribers.len() && counts.iter().all(|&count| count == 1) {
            return;
        }
        assert!(Instant::now() < deadline, "a link did not open");
        thread::sleep(Duration::from_micros(100));
    }
}

pub(crate) fn default_pair(domain: &Domain) -> (Publisher<[u8]>, Subscriber<[u8]>) {
    pair(
        domain,
        |node| node.publisher("topic").unwrap(),
        |node| node.subscriber("topic").unwrap(),
    )
}

/// Waits for the next request.
pub(crate) fn next_request<Q: Message + ?Sized, R: Message + ?Sized>(
    server: &Server<Q, R>,
) -> Request<Q, R> {
    server.recv_timeout(SOON).unwrap().expect("a request")
}

/// Waits until a child that was made by `fork(2)` has ended without an error.
pub(crate) fn until_exited(child: Pid) {
    let deadline = Instant::now() + SOON;
    loop {
        match waitpid(child, Some(WaitPidFlag::WNOHANG)).unwrap() {
            WaitStatus::StillAlive if Instant::now() < deadline => {
                thread::sleep(Duration::from_millis(1));
            }
            WaitStatus::StillAlive => {
                kill(child, Signal::SIGKILL).unwrap();
                waitpid(child, None).unwrap();
                panic!("the child does not end");
            }
            ended => {
                assert_eq!(ended, WaitStatus::Exited(child, 0));
                return;
            }
        }
    }
}

pub(crate) fn next<T: Message + ?Sized>(subscriber: &Subscriber<T>) -> Sample<T> {
    subscriber.recv_timeout(SOON).unwrap().expect("a message")
}
