//! Descriptors that nodes send to a Manager: it keeps one counters file per session, and closes all others.

use crate::common;
use std::{
    fs::{self, File},
    io::IoSlice,
    os::{
        fd::{AsFd, BorrowedFd, OwnedFd},
        unix::process::CommandExt,
    },
    process::Command,
    thread,
    time::Duration,
};

use crate::common::{Program, SOON, TestDomain};
use nix::unistd::{Uid, chown, geteuid};
use sm2_io::{CounterPage, CounterView, RecvError, SeqPacket, memfd, wait_readable};
use sm2_proto::{
    Code, Datagram, InterfaceId, NodeId, ViolationKind,
    control::{ToManager, ToNode, decode_to_node, encode_to_manager},
    violation,
};

/// A node that sends and receives single frames.
struct Raw {
    socket: SeqPacket,
    id: NodeId,
}

impl Raw {
    fn welcomed(domain: &TestDomain, name: &str) -> Self {
        let socket = SeqPacket::connect(&domain.socket()).unwrap();
        let mut raw = Self::greeting(socket, name);
        let (ToNode::Welcome { node, .. }, None) = raw.next() else {
            panic!("WELCOME expected");
        };
        raw.id = node;
        raw
    }

    /// Connects a node that has sent HELLO.
    fn greeting(socket: SeqPacket, name: &str) -> Self {
        let raw = Self {
            socket,
            id: NodeId(0),
        };
        let hello = ToManager::Hello {
            min_version: 1,
            max_version: 1,
            name: name.parse().unwrap(),
            resuming: false,
        };
        // The Manager may have closed the connection already; reading reports that.
        let _ = (raw.socket).send(&[IoSlice::new(&encode_to_manager(&hello))], &[]);
        raw
    }

    fn send(&self, frame: &ToManager, fds: &[BorrowedFd<'_>]) {
        let bytes = encode_to_manager(frame);
        self.socket.send(&[IoSlice::new(&bytes)], fds).unwrap();
    }

    fn inspect(&self, node: NodeId) {
        self.send(&ToManager::Inspect { node }, &[]);
    }

    /// Returns the next frame and its descriptor.
    #[track_caller]
    fn next(&self) -> (ToNode, Option<OwnedFd>) {
        self.try_next(SOON).expect("a frame")
    }

    fn try_next(&self, timeout: Duration) -> Option<(ToNode, Option<OwnedFd>)> {
        wait_readable(&[self.socket.as_fd()], Some(timeout)).unwrap();
        let mut buffer = vec![0; 65_537];
        let received = match self.socket.recv(&mut buffer) {
            Ok(received) => received,
            Err(RecvError::WouldBlock | RecvError::Closed) => return None,
            Err(error) => panic!("{error}"),
        };
        let facts = |fd: &OwnedFd| memfd::facts(fd.as_fd()).unwrap();
        let facts: Vec<_> = received.fds.iter().map(facts).collect();
        let frame = decode_to_node(&Datagram {
            bytes: &buffer[..received.len],
            fds: &facts,
            data_truncated: received.data_truncated,
            control_truncated: received.control_truncated,
        });
        Some((frame.unwrap(), received.fds.into_iter().next()))
    }

    /// Returns the code of the Manager's GOODBYE, and checks that the connection then ends.
    #[track_caller]
    fn goodbye(&self) -> Code {
        let (ToNode::Goodbye { code }, None) = self.next() else {
            panic!("GOODBYE expected");
        };
        assert!(self.try_next(SOON).is_none(), "the end");
        code
    }
}

/// Returns how many descriptors the Manager has open.
fn open(manager: &Program) -> usize {
    let entries = fs::read_dir(format!("/proc/{}/fd", manager.pid())).unwrap();
    entries.count()
}

/// A Manager accepts no more nodes than it can receive counters files from.
//= SM2-CNT-001, SM2-TRN-010 sys
#[test]
fn a_manager_that_is_short_of_descriptors_blames_no_node() {
    let domain = TestDomain::new();
    let mut command = Command::new("sh");
    command.arg("-c").arg("ulimit -n 32; exec \"$0\" \"$@\"");
    let program = domain.command(&[]);
    command.arg(program.get_program()).args(program.get_args());
    let manager = Program::start(command);
    manager.says("serving");
    let mut nodes: Vec<Raw> = Vec::new();
    while !manager.stderr().contains("cannot") {
        let name = format!("node-{}", nodes.len());
        let socket = SeqPacket::connect(&domain.socket()).unwrap();
        let raw = Raw::greeting(socket, &name);
        let answered = || wait_readable(&[raw.socket.as_fd()], Some(Duration::from_millis(10)));
        common::eventually("a WELCOME, or a log message why there is none", || {
            answered().unwrap() || manager.stderr().contains("cannot")
        });
        // The Manager has no descriptor left for the last node, which may get no answer.
        if let Some((ToNode::Welcome { node, .. }, None)) = raw.try_next(Duration::ZERO) {
            nodes.push(Raw { id: node, ..raw });
        }
    }
    assert!(nodes.len() > 4, "{}", nodes.len());
    let page = CounterPage::new().unwrap();
    for node in &nodes {
        node.send(&ToManager::Counters, &[page.as_fd()]);
        node.inspect(node.id);
        let (ToNode::Inspected { .. }, Some(_)) = node.next() else {
            panic!("INSPECTED expected");
        };
    }
}

//= SM2-CNT-001, SM2-CNT-003 sys
#[test]
fn counters_are_kept_with_the_session_and_shown_to_whoever_asks() {
    let domain = TestDomain::new();
    let manager = domain.manager(&[]);
    let tool = Raw::welcomed(&domain, "tool");
    let idle = open(&manager);

    let node = Raw::welcomed(&domain, "node");
    let mut page = CounterPage::new().unwrap();
    let mut entry = page
        .allocate(InterfaceId(7), None, sm2_proto::Instant(0))
        .unwrap();
    node.send(&ToManager::Counters, &[page.as_fd()]);
    node.inspect(node.id);
    let (ToNode::Inspected { .. }, Some(_)) = node.next() else {
        panic!("INSPECTED expected");
    };
    assert_eq!(
        open(&manager),
        idle + 3,
        "the node's socket, its process and its counters file"
    );

    entry.update().lost(3);
    for _ in 0..3 {
        tool.inspect(node.id);
        tool.inspect(tool.id);
    }
    for _ in 0..3 {
        let (ToNode::Inspected { node: of }, Some(file)) = tool.next() else {
            panic!("INSPECTED expected");
        };
        assert_eq!(of, node.id);
        let view = CounterView::open(file).unwrap();
        assert_eq!(view.read(entry.index()).unwrap().unwrap().lost, 3);
        let (ToNode::NotInspected { node: of }, None) = tool.next() else {
            panic!("NOT_INSPECTED expected");
        };
        assert_eq!(of, tool.id);
    }
    assert_eq!(
        open(&manager),
        idle + 3,
        "the Manager keeps no duplicate for the tool"
    );

    drop(node);
    common::eventually("the Manager to close the file", || open(&manager) == idle);
}

//= SM2-TRN-010, SM2-CNT-001 sys
#[test]
fn every_other_descriptor_is_closed() {
    let domain = TestDomain::new();
    let manager = domain.manager(&[]);
    let witness = Raw::welcomed(&domain, "witness");
    let idle = open(&manager);
    let page = CounterPage::new().unwrap();
    let null = File::open("/dev/null").unwrap();
    let (one, _other) = SeqPacket::pair().unwrap();
    let many = vec![null.as_fd(); 200];
    let one_too_many = [page.as_fd(), page.as_fd()];
    let counters = ToManager::Counters;
    let query = ToManager::Query { after: None };
    for (frame, fds, violation) in [
        (
            &counters,
            &[null.as_fd()][..],
            violation!(NotAMemfd, "SM2-CNT-001"),
        ),
        (
            &counters,
            &[one.as_fd()],
            violation!(NotAMemfd, "SM2-CNT-001"),
        ),
        (&counters, &[], violation!(FdCount, "SM2-TRN-010")),
        (&counters, &one_too_many, violation!(FdCount, "SM2-TRN-010")),
        (&counters, &many, violation!(FdCount, "SM2-TRN-010")),
        (&query, &[page.as_fd()], violation!(FdCount, "SM2-TRN-010")),
    ] {
        let node = Raw::welcomed(&domain, "node");
        node.send(frame, fds);
        assert_eq!(node.goodbye(), violation.code());
        drop(node);
        common::eventually("all descriptors to be closed", || open(&manager) == idle);
    }
    let node = Raw::welcomed(&domain, "node");
    node.send(&counters, &[page.as_fd()]);
    node.send(&counters, &[page.as_fd()]);
    assert_eq!(node.goodbye(), ViolationKind::CountersTwice.code());
    common::eventually("both descriptors to be closed", || open(&manager) == idle);
    witness.inspect(witness.id);
    let (ToNode::NotInspected { .. }, None) = witness.next() else {
        panic!("NOT_INSPECTED expected");
    };
}

/// Counters files that are sent to a tool count as in flight, as the sockets of links do.
//= SM2-TRN-009, SM2-TRN-008 sys
#[test]
fn whoever_asks_and_does_not_read_is_given_up() {
    let domain = TestDomain::new();
    let mut command = domain.for_a_stranger(&["--socket-mode", "666"]);
    let program = command.get_program().to_owned();
    let options: Vec<_> = command.get_args().map(ToOwned::to_owned).collect();
    // A low limit for descriptors in flight. The limit does not apply to root.
    command = Command::new("sh");
    command.args(["-c", "ulimit -n 128; exec \"$0\" \"$@\""]);
    command.arg(program).args(options);
    if geteuid().is_root() {
        let nobody = 65_534;
        chown(domain.folder(), Some(Uid::from_raw(nobody)), None).unwrap();
        command.uid(nobody).gid(nobody);
    }
    let manager = Program::start(command);
    manager.says("serving");
    let node = Raw::welcomed(&domain, "node");
    let page = CounterPage::new().unwrap();
    node.send(&ToManager::Counters, &[page.as_fd()]);
    let deaf = Raw::welcomed(&domain, "deaf");
    let bytes = encode_to_manager(&ToManager::Inspect { node: node.id });
    for _ in 0..100_000 {
        // Sends until the Manager closes the connection.
        match deaf.socket.send(&[IoSlice::new(&bytes)], &[]) {
            Ok(()) => {}
            Err(sm2_io::SendError::WouldBlock) => thread::yield_now(),
            Err(_) => break,
        }
    }
    manager.says("hung up");
    // Unread descriptors stay in flight until the node closes its end.
    drop(deaf);
    let polite = Raw::welcomed(&domain, "polite");
    for _ in 0..100 {
        polite.inspect(node.id);
        let (ToNode::Inspected { .. }, Some(_)) = polite.next() else {
            panic!("INSPECTED expected");
        };
    }
}
