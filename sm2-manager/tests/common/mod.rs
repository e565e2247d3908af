//! Shared helpers of this crate's tests: Managers in their own processes, and nodes without interfaces.
#![allow(dead_code, reason = "each test uses some of it")]

use std::{
    fs::{self, Permissions},
    io::{ErrorKind, IoSlice, Read},
    os::{fd::AsFd, unix::fs::PermissionsExt},
    path::{Path, PathBuf},
    process::{Child, Command, Stdio},
    sync::{Arc, Mutex},
    thread::{self, JoinHandle},
    time::{Duration, Instant},
};

use nix::{
    sys::signal::{Signal, kill},
    unistd::Pid,
};
use sm2_io::{RecvError, SeqPacket, clock, wait_readable};
use sm2_proto::{
    Datagram, Machine, Name, Refusal,
    control::{Item, Page},
    limits::DATAGRAM_MAX,
    node::{End, Input, Node, Output},
};

pub(crate) use sm2_test_support::{SOON, until as eventually};

/// A temporary folder for one domain.
pub(crate) struct TestDomain {
    folder: tempfile::TempDir,
}

impl TestDomain {
    pub(crate) fn new() -> Self {
        let folder = tempfile::Builder::new().prefix("sm2-").tempdir();
        Self {
            folder: folder.unwrap(),
        }
    }

    pub(crate) fn folder(&self) -> &Path {
        self.folder.path()
    }

    pub(crate) fn socket(&self) -> PathBuf {
        self.folder().join("domain.sock")
    }

    /// Returns the names of the files in the folder, sorted.
    pub(crate) fn files(&self) -> Vec<String> {
        let entries = fs::read_dir(self.folder()).unwrap();
        let names = entries.map(|it| it.unwrap().file_name().into_string().unwrap());
        let mut names: Vec<String> = names.collect();
        names.sort();
        names
    }

    /// Returns the command that starts the program with this folder's socket.
    pub(crate) fn command(&self, options: &[&str]) -> Command {
        let mut command = Command::new(env!("CARGO_BIN_EXE_sm2-manager"));
        command.arg("--socket").arg(self.socket()).args(options);
        command.env_remove("SM2_LOG").env_remove("NOTIFY_SOCKET");
        command
    }

    /// Returns the command with the program copied into this folder, both accessible to other users.
    pub(crate) fn for_a_stranger(&self, options: &[&str]) -> Command {
        fs::set_permissions(self.folder(), Permissions::from_mode(0o755)).unwrap();
        let program = self.folder().join("program");
        if !program.exists() {
            // `cp` writes the copy in another process. If this process wrote it, a child that another thread
            // is starting would inherit the open file, and a file open for writing cannot be executed.
            let mut copy = Command::new("cp");
            copy.arg(env!("CARGO_BIN_EXE_sm2-manager")).arg(&program);
            assert!(copy.status().unwrap().success());
        }
        let mut command = Command::new(program);
        command.arg("--socket").arg(self.socket()).args(options);
        command
    }

    /// Starts a Manager and waits until it serves.
    #[track_caller]
    pub(crate) fn manager(&self, options: &[&str]) -> Program {
        let program = Program::start(self.command(options));
        program.says("serving");
        program
    }

    /// Starts a standby and waits until it stands by.
    #[track_caller]
    pub(crate) fn standby(&self) -> Program {
        let program = Program::start(self.command(&["--standby"]));
        program.says("standing by");
        program
    }

    /// Runs a program that ends at once. Returns its exit status and its standard error.
    #[track_caller]
    pub(crate) fn fails(&self, options: &[&str]) -> (Option<i32>, String) {
        let mut program = Program::start(self.command(options));
        let status = program.wait();
        (status, program.stderr())
    }

    #[track_caller]
    pub(crate) fn client(&self, name: &str) -> Client {
        Client::welcomed(&self.socket(), name)
    }
}

/// A Manager in its own process. Killed when dropped.
pub(crate) struct Program {
    child: Child,
    stderr: Arc<Mutex<String>>,
    reader: Option<JoinHandle<()>>,
}

impl Program {
    pub(crate) fn start(mut command: Command) -> Self {
        let mut child = command.stderr(Stdio::piped()).spawn().unwrap();
        let mut source = child.stderr.take().unwrap();
        let stderr = Arc::new(Mutex::new(String::new()));
        let collected = Arc::clone(&stderr);
        let reader = thread::spawn(move || {
            let mut buffer = [0; 4096];
            while let Ok(len @ 1..) = source.read(&mut buffer) {
                let text = String::from_utf8_lossy(&buffer[..len]);
                collected.lock().unwrap().push_str(&text);
            }
        });
        let reader = Some(reader);
        Self {
            child,
            stderr,
            reader,
        }
    }

    pub(crate) fn pid(&self) -> i32 {
        self.child.id().cast_signed()
    }

    pub(crate) fn stderr(&self) -> String {
        self.stderr.lock().unwrap().clone()
    }

    #[track_caller]
    pub(crate) fn says(&self, text: &str) {
        eventually(text, || self.stderr().contains(text));
    }

    /// Sends a signal. The process id stays valid until the process was waited for.
    pub(crate) fn signal(&self, signal: Signal) {
        kill(Pid::from_raw(self.pid()), signal).unwrap();
    }

    /// Sends SIGKILL without waiting for the end.
    pub(crate) fn kill(&mut self) {
        self.child.kill().unwrap();
    }

    pub(crate) fn is_running(&mut self) -> bool {
        self.child.try_wait().unwrap().is_none()
    }

    /// Waits for the end of the process and of its output. `None` if a signal ended it.
    #[track_caller]
    pub(crate) fn wait(&mut self) -> Option<i32> {
        let mut status = None;
        eventually("the end of a process", || {
            status = self.child.try_wait().unwrap();
            status.is_some()
        });
        if let Some(reader) = self.reader.take() {
            reader.join().unwrap();
        }
        status.unwrap().code()
    }
}

impl Drop for Program {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
        if thread::panicking() {
            eprintln!("process {} said: {}", self.pid(), self.stderr());
        }
    }
}

/// A node without interfaces.
pub(crate) struct Client {
    socket: SeqPacket,
    machine: Node,
    welcomed: bool,
    refused: Option<Refusal>,
    page: Option<Vec<Item>>,
    buffer: Vec<u8>,
}

/// The reason why a node has no session and may try again (SM2-RES-001).
#[derive(Debug)]
pub(crate) enum Retry {
    /// No process listens at the path, or the queue of connections is full.
    NotConnected,
    /// The Manager ended before it sent WELCOME.
    NotWelcomed,
}

impl Client {
    /// Connects and greets, with as many attempts as it takes.
    #[track_caller]
    pub(crate) fn welcomed(path: &Path, name: &str) -> Self {
        let mut client = None;
        eventually("a session", || {
            client = Self::attempt(path, name).ok();
            client.is_some()
        });
        client.unwrap()
    }

    /// Connects and greets, with one attempt. Panics on an error that must not be tried again.
    #[track_caller]
    pub(crate) fn attempt(path: &Path, name: &str) -> Result<Self, Retry> {
        let mut client = Self::connect(path, name)?;
        client.greeted()?;
        Ok(client)
    }

    /// Connects and sends HELLO.
    #[track_caller]
    pub(crate) fn connect(path: &Path, name: &str) -> Result<Self, Retry> {
        let socket = match SeqPacket::connect(path) {
            Ok(socket) => socket,
            Err(error) => match error.kind() {
                ErrorKind::ConnectionRefused | ErrorKind::WouldBlock | ErrorKind::NotFound => {
                    return Err(Retry::NotConnected);
                }
                _ => panic!("{name}: {error}"),
            },
        };
        let mut client = Self {
            socket,
            machine: Node::new(Name::new(name).unwrap()),
            welcomed: false,
            refused: None,
            page: None,
            buffer: vec![0; DATAGRAM_MAX + 1],
        };
        client.carry_out();
        Ok(client)
    }

    /// Waits for WELCOME.
    #[track_caller]
    pub(crate) fn greeted(&mut self) -> Result<(), Retry> {
        self.until(|it| it.welcomed || it.refused.is_some() || it.machine.end().is_some());
        assert_eq!(self.refused, None);
        match (self.welcomed, self.machine.end()) {
            (true, _) => Ok(()),
            (false, Some(End::Violation(violation))) => panic!("{violation}"),
            (false, _) => Err(Retry::NotWelcomed),
        }
    }

    /// Returns the process that was listening when this node connected.
    pub(crate) fn server(&self) -> i32 {
        self.socket.peer_credentials().unwrap().pid
    }

    pub(crate) fn epoch(&self) -> u64 {
        self.machine.epoch().unwrap()
    }

    /// Returns the names of the domain's nodes, in the order in which they joined.
    #[track_caller]
    pub(crate) fn nodes(&mut self) -> Vec<String> {
        self.page = None;
        let query = Input::Query { after: None };
        self.machine.handle(clock::now(), query).unwrap();
        self.carry_out();
        self.until(|it| it.page.is_some());
        let items = self.page.take().unwrap().into_iter();
        let names = items.filter_map(|item| match item {
            Item::Node { name, .. } => Some(name.as_str().to_owned()),
            _ => None,
        });
        names.collect()
    }

    /// Waits for the end of the session.
    #[track_caller]
    pub(crate) fn ended(mut self) -> End {
        self.until(|it| it.machine.end().is_some());
        self.machine.end().unwrap()
    }

    #[track_caller]
    fn until(&mut self, mut done: impl FnMut(&Self) -> bool) {
        let late = Instant::now() + SOON;
        while !done(self) {
            assert!(Instant::now() < late, "the Manager says nothing");
            let pause = Some(Duration::from_secs(1));
            if wait_readable(&[self.socket.as_fd()], pause).unwrap() {
                self.receive();
            }
        }
    }

    fn receive(&mut self) {
        let input = match self.socket.recv(&mut self.buffer) {
            Ok(received) => Input::Datagram(Datagram {
                bytes: &self.buffer[..received.len],
                fds: &[],
                data_truncated: received.data_truncated,
                control_truncated: received.control_truncated,
            }),
            Err(RecvError::WouldBlock) => return,
            Err(RecvError::Closed | RecvError::Io(_)) => Input::Eof,
        };
        let _ = self.machine.handle(clock::now(), input);
        self.carry_out();
    }

    fn carry_out(&mut self) {
        while let Some(output) = self.machine.poll() {
            match output {
                // If the Manager is gone, reading the socket reports that.
                Output::Transmit(frame) => {
                    let _ = self.socket.send(&[IoSlice::new(&frame)], &[]);
                }
                Output::Welcomed { .. } => self.welcomed = true,
                Output::HelloRefused(reason) => self.refused = Some(reason),
                Output::Page(Page { items, .. }) => self.page = Some(items),
                _ => {}
            }
        }
    }
}
