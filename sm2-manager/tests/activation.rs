//! Socket activation as systemd does it: the test binds the socket, passes it as descriptor 3, and receives
//! the states that the Manager reports.

use std::{
    os::{
        fd::OwnedFd,
        unix::net::{UnixDatagram, UnixListener},
    },
    process::{Command, Stdio},
    time::Duration,
};

use crate::common::{Client, Program, SOON, TestDomain};
use nix::sys::signal::Signal;
use sm2_io::{Listener, SeqPacket};
use sm2_proto::{Farewell, node::End};

/// A service manager for one domain.
struct Init {
    domain: TestDomain,
    socket: OwnedFd,
    notify: UnixDatagram,
}

impl Init {
    fn new() -> Self {
        let domain = TestDomain::new();
        let socket = Listener::bind(&domain.socket(), 16).unwrap().into();
        let notify = UnixDatagram::bind(domain.folder().join("notify")).unwrap();
        notify.set_read_timeout(Some(SOON)).unwrap();
        Self {
            domain,
            socket,
            notify,
        }
    }

    /// Returns a command that passes `count` sockets, starting at descriptor 3.
    fn command(&self, socket: OwnedFd, count: usize, options: &[&str]) -> Command {
        // A shell moves the descriptors to their numbers and knows its own process id.
        let script = "exec 3<&0 4<&0 0</dev/null; LISTEN_PID=$$ exec \"$@\"";
        let mut command = Command::new("sh");
        command.args(["-c", script, "sh"]);
        command.arg(env!("CARGO_BIN_EXE_sm2-manager")).args(options);
        command.env("LISTEN_FDS", count.to_string());
        command.env("NOTIFY_SOCKET", self.domain.folder().join("notify"));
        command.stdin(Stdio::from(socket));
        command
    }

    fn start(&self, options: &[&str]) -> Program {
        let socket = self.socket.try_clone().unwrap();
        Program::start(self.command(socket, 1, options))
    }

    #[track_caller]
    fn fails(&self, command: Command) -> String {
        let mut program = Program::start(command);
        assert_eq!(program.wait(), Some(1));
        program.stderr()
    }

    /// Waits until the Manager reports the state `word`.
    #[track_caller]
    fn hears(&self, word: &str) {
        let mut buffer = [0; 4096];
        loop {
            let len = self.notify.recv(&mut buffer).expect(word);
            let text = String::from_utf8_lossy(&buffer[..len]);
            if text.lines().any(|line| line == word) {
                return;
            }
        }
    }
}

//= SM2-TRN-007 sys
#[test]
fn whoever_connects_between_two_managers_is_served() {
    let init = Init::new();
    let path = init.domain.socket();
    // Connects before the first Manager starts.
    let mut early = Client::connect(&path, "early").unwrap();
    let mut manager = init.start(&[]);
    init.hears("READY=1");
    early.greeted().expect("a session");
    assert_eq!(early.server(), std::process::id().cast_signed());
    for round in 0..3 {
        let node = init.domain.client("node");
        assert_eq!(
            node.server(),
            manager.pid(),
            "--replace would signal the Manager, not the service manager"
        );
        manager.kill();
        manager.wait();
        assert_eq!(node.ended(), End::Eof);
        let mut between = Client::connect(&path, "between").expect("the socket is there");
        manager = init.start(&[]);
        init.hears("READY=1");
        between.greeted().expect("a session");
        assert_eq!(between.nodes(), ["between"], "round {round}");
    }
    let node = init.domain.client("node");
    manager.signal(Signal::SIGTERM);
    init.hears("STOPPING=1");
    assert_eq!(node.ended(), End::Peer(Farewell::ShuttingDown.code()));
    assert_eq!(manager.wait(), Some(0));
    assert_eq!(init.domain.files(), ["domain.sock", "notify"]);
    SeqPacket::connect(&path).expect("the socket is there");
}

#[test]
fn a_manager_that_was_handed_its_socket_does_not_hand_over() {
    let init = Init::new();
    let manager = init.start(&["--socket", init.domain.socket().to_str().unwrap()]);
    init.hears("READY=1");
    let mut node = init.domain.client("node");
    manager.signal(Signal::SIGUSR2);
    manager.says("restart this Manager instead");
    assert_eq!(node.nodes(), ["node"]);
    let (status, text) = init.domain.fails(&[]);
    assert_eq!(status, Some(1), "{text}");
    assert!(text.contains("another Manager serves"), "{text}");
}

#[test]
fn what_is_of_no_use_is_refused_with_what_to_do() {
    let init = Init::new();
    let socket = || init.socket.try_clone().unwrap();
    let text = init.fails(init.command(socket(), 2, &[]));
    assert!(text.contains("one ListenSequentialPacket= line"), "{text}");

    let stream = UnixListener::bind(init.domain.folder().join("stream")).unwrap();
    let text = init.fails(init.command(stream.into(), 1, &[]));
    assert!(text.contains("use ListenSequentialPacket="), "{text}");

    let (connected, _other) = SeqPacket::pair().unwrap();
    let text = init.fails(init.command(connected.into(), 1, &[]));
    assert!(text.contains("ListenSequentialPacket="), "{text}");

    for option in ["--standby", "--replace"] {
        let text = init.fails(init.command(socket(), 1, &[option]));
        assert!(text.contains("LISTEN_FDS"), "{text}");
    }
    let text = init.fails(init.command(socket(), 1, &["--socket", "/run/other.sock"]));
    assert!(text.contains("/run/other.sock"), "{text}");
    assert!(text.contains("domain.sock"), "{text}");
    SeqPacket::connect(&init.domain.socket()).expect("the socket is there");
}

#[test]
fn a_manager_that_makes_its_own_socket_says_when_it_serves_and_when_it_stands_by() {
    let init = Init::new();
    let domain = TestDomain::new();
    let start = |options: &[&str]| {
        let mut command = domain.command(options);
        command.env("NOTIFY_SOCKET", init.domain.folder().join("notify"));
        Program::start(command)
    };
    let mut active = start(&[]);
    init.hears("STATUS=Serving");
    let mut standby = start(&["--standby"]);
    init.hears("STATUS=Standing by: another Manager serves");
    active.kill();
    init.hears("STATUS=Serving");
    standby.signal(Signal::SIGTERM);
    init.hears("STOPPING=1");
    assert_eq!(standby.wait(), Some(0));
    let silent = init.notify.set_read_timeout(Some(Duration::from_millis(1)));
    silent.unwrap();
    assert!(init.notify.recv(&mut [0; 100]).is_err(), "all was heard");
}
