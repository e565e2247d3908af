//! The example `own_loop`, a Manager with another event loop, with real nodes and with hostile ones.

use std::fs::File;
use std::io::{BufRead, BufReader, IoSlice};
use std::os::fd::{AsFd, OwnedFd};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::sync::mpsc::{Receiver, channel};
use std::time::{Duration, Instant};

use nix::sys::signal::{Signal, kill};
use nix::unistd::Pid;
use sm2_io::{CounterPage, CounterView, RecvError, SendError, SeqPacket, wait_readable};
use sm2_node::{Node, Publisher, Subscriber};
use sm2_proto::control::{ToManager, ToNode, decode_to_node, encode_to_manager};
use sm2_proto::{Code, Datagram, Farewell, FdFacts, InterfaceId, Name, NodeId, ViolationKind};
use sm2_test_support::SOON;

/// The environment variable that names the socket for the other process of a test.
const SOCKET: &str = "SM2_OWN_LOOP_TEST_SOCKET";

/// The running example, or another process that prints lines. Killed when dropped.
struct Process {
    child: Child,
    lines: Receiver<String>,
}

impl Process {
    fn start(command: &mut Command) -> Self {
        let mut child = command.stdout(Stdio::piped()).spawn().unwrap();
        let stdout = BufReader::new(child.stdout.take().unwrap());
        let (sender, lines) = channel();
        std::thread::spawn(move || {
            let mut lines = stdout.lines().map_while(Result::ok);
            lines.all(|line| sender.send(line).is_ok())
        });
        Self { child, lines }
    }

    /// Returns the next line that contains `part`.
    fn line(&self, part: &str) -> String {
        let deadline = Instant::now() + SOON;
        loop {
            let left = deadline.saturating_duration_since(Instant::now());
            match self.lines.recv_timeout(left) {
                Ok(line) if line.contains(part) => return line,
                Ok(_) => {}
                Err(error) => panic!("no line contains {part:?}: {error}"),
            }
        }
    }

    fn is_running(&mut self) -> bool {
        self.child.try_wait().unwrap().is_none()
    }

    /// Sends SIGINT, as Ctrl-C does.
    fn interrupt(&self) {
        let id = Pid::from_raw(self.child.id().try_into().unwrap());
        kill(id, Signal::SIGINT).unwrap();
    }

    /// Waits for the end. Returns the exit status and the lines that were not read yet.
    fn end(mut self) -> (Option<i32>, Vec<String>) {
        wait(|| !self.is_running());
        let status = self.child.wait().unwrap();
        (status.code(), self.lines.iter().collect())
    }
}

impl Drop for Process {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

/// The example, serving in its own folder.
struct Domain {
    process: Process,
    folder: tempfile::TempDir,
}

impl Domain {
    fn start() -> Self {
        Self::run(&mut Command::new(example()))
    }

    /// Starts the example with a limit of `limit` descriptors.
    fn start_with_files(limit: u32) -> Self {
        let script = format!("ulimit -n {limit} && exec \"$0\" \"$@\"");
        Self::run(Command::new("sh").args(["-c", &script]).arg(example()))
    }

    fn run(command: &mut Command) -> Self {
        let folder = tempfile::tempdir().unwrap();
        let process = Process::start(command.arg(folder.path().join("own.sock")));
        process.line("serving ");
        Self { process, folder }
    }

    fn socket(&self) -> PathBuf {
        self.folder.path().join("own.sock")
    }

    fn node(&self, name: &str) -> Node {
        node(&self.socket(), name)
    }

    fn raw(&self) -> Raw {
        Raw(SeqPacket::connect(&self.socket()).unwrap())
    }

    /// Returns a publisher and a subscriber of two nodes, once their link is open and their queues are empty.
    fn pair(&self) -> (Publisher<u64>, Subscriber<u64>) {
        let files = self.open_files(u32::MAX);
        let publisher = self.node("talker").publisher("topic").unwrap();
        let subscriber = self.node("listener").subscriber("topic").unwrap();
        meet(&publisher, &subscriber);
        // For each node one connection and one counters file.
        self.has_files(files + 4);
        (publisher, subscriber)
    }

    /// Counts the open descriptors below `limit`. (The process may have inherited others.)
    fn open_files(&self, limit: u32) -> usize {
        let id = self.process.child.id();
        let files = std::fs::read_dir(format!("/proc/{id}/fd")).unwrap();
        let number = |file: &std::fs::DirEntry| file.file_name().to_str()?.parse::<u32>().ok();
        let below = |file: &std::fs::DirEntry| number(file).is_some_and(|it| it < limit);
        files.filter(|file| below(file.as_ref().unwrap())).count()
    }

    /// Waits until exactly `count` descriptors are open.
    fn has_files(&self, count: usize) {
        wait(|| self.open_files(u32::MAX) == count);
    }
}

fn example() -> PathBuf {
    let test = std::env::current_exe().unwrap();
    let path = test.ancestors().nth(2).unwrap().join("examples/own_loop");
    assert!(
        path.exists(),
        "{path:?} is built by: cargo test -p sm2-manager"
    );
    path
}

fn node(socket: &Path, name: &str) -> Node {
    let builder = Node::builder(name).socket(socket);
    builder.manager_timeout(SOON).connect().unwrap()
}

/// Both nodes belong to this thread, so both must be called until their link is open.
fn meet(publisher: &Publisher<u64>, subscriber: &Subscriber<u64>) {
    wait(|| {
        let mut links = publisher.links();
        links.extend(subscriber.links());
        links.iter().filter(|link| link.open).count() == 2
    });
}

/// Calls `is_so` repeatedly until it returns true.
fn wait(mut is_so: impl FnMut() -> bool) {
    let deadline = Instant::now() + SOON;
    while !is_so() {
        assert!(Instant::now() < deadline, "waited in vain");
        std::thread::sleep(Duration::from_micros(100));
    }
}

fn deliver(publisher: &Publisher<u64>, subscriber: &Subscriber<u64>, number: u64) {
    assert_eq!(publisher.publish(&number).unwrap().links, 1);
    let sample = subscriber.recv_timeout(SOON).unwrap().expect("a message");
    assert_eq!(*sample, number);
}

/// A node that is only a socket.
struct Raw(SeqPacket);

impl Raw {
    fn hello(name: &str) -> ToManager {
        ToManager::Hello {
            min_version: 1,
            max_version: 1,
            name: Name::new(name).unwrap(),
            resuming: false,
        }
    }

    fn welcomed(self, name: &str) -> Self {
        self.send(&Self::hello(name));
        let answer = self.next();
        assert!(matches!(answer, Some(ToNode::Welcome { .. })), "{answer:?}");
        self
    }

    fn send(&self, frame: &ToManager) {
        self.send_bytes(&encode_to_manager(frame));
    }

    fn send_bytes(&self, bytes: &[u8]) {
        self.0.send(&[IoSlice::new(bytes)], &[]).unwrap();
    }

    /// Returns the next frame; `None` at the end of the connection.
    fn next(&self) -> Option<ToNode> {
        self.next_with_fds().map(|(frame, _)| frame)
    }

    fn next_with_fds(&self) -> Option<(ToNode, Vec<OwnedFd>)> {
        let mut buffer = [0; 65_536];
        loop {
            match self.0.recv(&mut buffer) {
                Ok(received) => {
                    let datagram = Datagram {
                        fds: &vec![FdFacts::default(); received.fds.len()],
                        ..Datagram::new(&buffer[..received.len])
                    };
                    let frame = decode_to_node(&datagram).unwrap();
                    return Some((frame, received.fds.into_vec()));
                }
                Err(RecvError::Closed) => return None,
                Err(RecvError::WouldBlock) => {
                    let came = wait_readable(&[self.0.as_fd()], Some(SOON)).unwrap();
                    assert!(came, "nothing comes");
                }
                Err(error) => panic!("{error}"),
            }
        }
    }

    /// Checks that the Manager ends the session with this code.
    fn hung_up(&self, code: Code) {
        assert_eq!(self.next(), Some(ToNode::Goodbye { code }));
        assert_eq!(self.next(), None);
    }
}

#[test]
fn nodes_of_other_processes_talk_through_it() {
    let domain = Domain::start();
    let listener = Process::start(
        Command::new(std::env::current_exe().unwrap())
            .args([
                "--exact",
                "own_loop::the_listener",
                "--ignored",
                "--nocapture",
            ])
            .env(SOCKET, domain.socket()),
    );
    let node = domain.node("talker");
    let publisher = node.publisher_builder::<u64>("topic").depth(1_024);
    let publisher = publisher.declare().unwrap();
    publisher.wait_for_subscribers_timeout(1, SOON).unwrap();
    for number in 1..=500 {
        publisher.publish(&number).unwrap();
    }
    assert!(publisher.flush_timeout(SOON).unwrap());
    for number in 1..=500 {
        let line = listener.line("talker says ");
        assert!(line.ends_with(&format!("talker says {number}")), "{line}");
    }
    assert_eq!(listener.end().0, Some(0));
    domain.process.line(" joins node ");
    domain.process.line("said goodbye: done");
}

#[test]
#[ignore = "runs in a child process of another test"]
fn the_listener() {
    let Some(socket) = std::env::var_os(SOCKET) else {
        return;
    };
    let node = node(socket.as_ref(), "listener");
    let subscriber = node.subscriber_builder::<u64>("topic").depth(1_024);
    let subscriber = subscriber.declare().unwrap();
    for _ in 0..500 {
        let sample = subscriber.recv_timeout(SOON).unwrap().expect("a message");
        println!("{} says {}", sample.publisher(), *sample);
    }
}

#[test]
fn a_violation_ends_its_session_alone() {
    let domain = Domain::start();
    let (publisher, subscriber) = domain.pair();
    let files = domain.open_files(u32::MAX);

    let garbage = domain.raw();
    garbage.send_bytes(b"\xff\xff\xff\xff\x7f");
    garbage.hung_up(ViolationKind::UnknownFrame.code());
    domain
        .process
        .line("broke the protocol: unknown-frame (SM2-");

    let stranger = domain.raw();
    let file = File::open("/dev/null").unwrap();
    let hello = encode_to_manager(&Raw::hello("stranger"));
    let parts = [IoSlice::new(&hello)];
    stranger.0.send(&parts, &[file.as_fd()]).unwrap();
    stranger.hung_up(ViolationKind::FdCount.code());

    let long = domain.raw();
    long.send_bytes(&[0; 65_537]);
    long.hung_up(ViolationKind::FrameTooLong.code());

    let twice = domain.raw().welcomed("twice");
    twice.send(&Raw::hello("twice"));
    twice.hung_up(ViolationKind::UnexpectedHello.code());

    domain.has_files(files);
    deliver(&publisher, &subscriber, 1);
    let late = domain.node("late").subscriber::<u64>("topic").unwrap();
    assert_eq!(late.matched(), 1);
}

#[test]
fn sessions_end_as_their_nodes_do() {
    let domain = Domain::start();
    let files = domain.open_files(u32::MAX);
    let gone = domain.raw().welcomed("one");
    drop(gone);
    // The name is free as soon as the node that had it is gone.
    let polite = domain.raw().welcomed("one");
    let code = Farewell::Done.code();
    polite.send(&ToManager::Goodbye { code });
    assert_eq!(polite.next(), None);
    domain.process.line("node 1 is gone");
    domain.process.line("node 2 said goodbye: done");

    let silent = domain.raw();
    silent.hung_up(Farewell::GreetingTimeout.code());
    domain
        .process
        .line("node 3 was told to go: greeting-timeout");
    domain.has_files(files);
}

#[test]
fn a_node_that_does_not_read_is_given_up_alone() {
    let domain = Domain::start();
    let (publisher, subscriber) = domain.pair();
    let deaf = domain.raw().welcomed("deaf");
    let query = encode_to_manager(&ToManager::Query { after: None });
    let deadline = Instant::now() + SOON;
    loop {
        match deaf.0.send(&[IoSlice::new(&query)], &[]) {
            Ok(()) => {}
            Err(SendError::WouldBlock) => std::thread::sleep(Duration::from_micros(100)),
            Err(SendError::Closed) => break,
            Err(error) => panic!("{error}"),
        }
        assert!(
            Instant::now() < deadline,
            "the node was not given up in time"
        );
    }
    domain.process.line("was told to go: stalled");
    deliver(&publisher, &subscriber, 1);
}

/// The Manager keeps a node's counters file as long as the session lives, and sends it to tools.
#[test]
fn it_keeps_counters_and_shows_them() {
    let domain = Domain::start();
    let curious = domain.raw().welcomed("curious");
    let counted = domain.raw().welcomed("counted");
    let files = domain.open_files(u32::MAX);

    let mut page = CounterPage::new().unwrap();
    let interface = InterfaceId(7);
    let mut entry = page
        .allocate(interface, None, sm2_proto::Instant(0))
        .expect("the page is empty");
    entry.update().lost(3);
    let frame = encode_to_manager(&ToManager::Counters);
    let parts = [IoSlice::new(&frame)];
    counted.0.send(&parts, &[page.as_fd()]).unwrap();
    domain.has_files(files + 1);

    for (node, known) in [(1, false), (2, true)].map(|(node, known)| (NodeId(node), known)) {
        curious.send(&ToManager::Inspect { node });
        let (answer, fds) = curious.next_with_fds().expect("an answer");
        if !known {
            assert_eq!(answer, ToNode::NotInspected { node });
            continue;
        }
        assert_eq!(answer, ToNode::Inspected { node });
        let [fd] = fds.try_into().expect("one descriptor");
        let entries: Vec<_> = CounterView::open(fd).unwrap().entries().collect();
        assert_eq!(entries.len(), 1);
        assert_eq!(entries[0].1.as_ref().unwrap().lost, 3);
    }
    drop(counted);
    domain.has_files(files - 1);
}

/// If the socket pair of a link cannot be created, there is no link; connections that cannot be accepted
/// wait.
#[test]
fn it_goes_on_where_descriptors_are_short() {
    const LIMIT: u32 = 24;
    let domain = Domain::start_with_files(LIMIT);
    let files = domain.open_files(u32::MAX);
    let (talker, listener) = (domain.node("talker"), domain.node("listener"));
    let earlier = talker.publisher::<u64>("earlier").unwrap();
    let heard = listener.subscriber::<u64>("earlier").unwrap();
    meet(&earlier, &heard);
    // Each node has a session and has handed over its counters.
    domain.has_files(files + 4);
    let mut crowd = Vec::new();
    while domain.open_files(LIMIT) < LIMIT as usize {
        let name = format!("crowd/{}", crowd.len());
        crowd.push(domain.raw().welcomed(&name));
    }
    let publisher = talker.publisher::<u64>("topic").unwrap();
    let subscriber = listener.subscriber::<u64>("topic").unwrap();
    domain.process.line("was not made: ");
    assert!(publisher.links().is_empty());
    drop(subscriber);

    let late = domain.raw();
    late.send(&Raw::hello("late"));
    domain.process.line("cannot accept a connection: ");
    crowd.truncate(crowd.len() - 4);
    assert!(matches!(late.next(), Some(ToNode::Welcome { .. })));
    let subscriber = listener.subscriber::<u64>("topic").unwrap();
    meet(&publisher, &subscriber);
    deliver(&publisher, &subscriber, 1);
    deliver(&earlier, &heard, 1);
}

#[test]
fn ctrl_c_ends_it_and_no_link() {
    let domain = Domain::start();
    let (publisher, subscriber) = domain.pair();
    let idle = domain.raw().welcomed("idle");
    domain.process.interrupt();
    idle.hung_up(Farewell::ShuttingDown.code());
    let Domain { process, folder } = domain;
    let (status, lines) = process.end();
    assert_eq!(status, Some(0));
    let told = |line: &&String| line.ends_with("was told to go: shutting-down");
    assert_eq!(lines.iter().filter(told).count(), 3, "{lines:?}");
    deliver(&publisher, &subscriber, 1);
    assert_eq!(folder.path().read_dir().unwrap().count(), 0);
}

/// The nodes reconnect to the next Manager, which adopts their link and creates no other.
#[test]
fn the_next_one_goes_on() {
    let mut domain = Domain::start();
    let talker = domain.node("talker");
    let listener = domain.node("listener");
    let publisher = talker.publisher::<u64>("topic").unwrap();
    let subscriber = listener.subscriber::<u64>("topic").unwrap();
    meet(&publisher, &subscriber);
    domain.process.interrupt();
    let socket = domain.socket();
    // Both nodes notice the end before the next Manager starts.
    wait(|| !talker.is_connected() && !listener.is_connected());
    wait(|| !domain.process.is_running());
    domain.process = Process::start(Command::new(example()).arg(socket));
    domain.process.line("serving ");
    wait(|| {
        let (one, other) = (talker.is_connected(), listener.is_connected());
        one && other
    });
    deliver(&publisher, &subscriber, 1);
    let late = domain.node("late").subscriber::<u64>("topic").unwrap();
    assert_eq!(late.matched(), 1);
    assert_eq!(subscriber.links().len(), 1);
}
