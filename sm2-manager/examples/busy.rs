//! How long a busy Manager occupies itself in one piece, and how long a quiet node waits beside busy ones.
//!
//! `cargo run --release -p sm2-manager --example busy`
//!
//! The first table is the processor time of the longest piece of work: one input of the machine with all its
//! outputs, over real sockets. The other tables compare a DECLARE of one node with an echo through a plain
//! socket, while 50 processes declare and withdraw a subscriber with 80 matches without pause: with a Manager of the
//! same priority as all others, and with the priority that the systemd units give it (`nice -n -10`, which needs a
//! right).

use std::{
    error::Error,
    io::IoSlice,
    os::fd::{AsFd, OwnedFd},
    path::{Path, PathBuf},
    process::{Child, Command, Stdio},
    thread,
    time::{Duration, Instant as Clock},
};

use nix::time::{ClockId, clock_gettime};
use sm2_io::{SeqPacket, wait_readable};
use sm2_manager::{Manager, Options};
use sm2_proto::{
    Contract, Datagram, DemandedQos, FdFacts, InterfaceId, Machine, Name, NodeId, OfferedQos,
    TypeId,
    control::{Limits, ToManager, ToNode, decode_to_node, encode_to_manager},
    limits::DATAGRAM_MAX,
    manager::{self, Credentials, Input, Output},
};

const CHURNERS: usize = 50;
const CROWDS: usize = 4;
const MATCHES: u64 = 80;
const ROUNDS: u64 = 2_000;
/// The nice value of a Manager in the systemd units.
const UNIT_NICE: i32 = -10;
/// Publishers of each of four sessions in the first table.
const MANY: u64 = 1_000;

type Done = Result<(), Box<dyn Error>>;

fn main() -> Done {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let words: Vec<&str> = arguments.iter().map(String::as_str).collect();
    match words[..] {
        [] => {
            longest_pieces()?;
            compare(0)?;
            compare(UNIT_NICE)
        }
        ["manager", path] => {
            Manager::bind(Path::new(path), Options::default())?.run()?;
            Ok(())
        }
        ["churn", path, name] => churn(Path::new(path), name),
        ["crowd", path, name] => crowd(Path::new(path), name),
        ["echo"] => echo(),
        _ => Err("no arguments are needed".into()),
    }
}

/// A machine with 4,000 publishers of one topic, and the sockets that its outputs use.
struct Domain {
    machine: manager::Manager,
    wire: (SeqPacket, SeqPacket),
    sessions: u64,
    longest: Duration,
    buffer: Vec<u8>,
}

fn longest_pieces() -> Done {
    println!("longest piece of work, processor time");
    for work in [
        "DECLARE",
        "WITHDRAW",
        "end of a session",
        "CLAIMED, 1,024 x 4,000",
    ] {
        let mut domain = Domain::new()?;
        for at in 0..4 {
            let node = domain.node(&format!("crowd-{at}"), false)?;
            for interface in 1..=MANY {
                domain.send(node, &declare(interface, publisher("t")))?;
            }
        }
        let resuming = work.starts_with("CLAIMED");
        let node = domain.node("busy", resuming)?;
        let count = if resuming { 1_024 } else { 1 };
        domain.longest = Duration::ZERO;
        for interface in 1..=count {
            domain.send(node, &declare(interface, subscriber("t")))?;
        }
        if work != "DECLARE" {
            domain.longest = Duration::ZERO;
        }
        match work {
            "WITHDRAW" => domain.send(node, &withdraw(1))?,
            "end of a session" => domain.feed(Input::Closed { session: node })?,
            "DECLARE" => {}
            _ => domain.send(node, &ToManager::Claimed)?,
        }
        println!("  {work:<24} {:>8.1?}", domain.longest);
    }
    Ok(())
}

impl Domain {
    fn new() -> Result<Self, Box<dyn Error>> {
        Ok(Self {
            machine: manager::Manager::new(1, 7, Limits::default()),
            wire: SeqPacket::pair()?,
            sessions: 0,
            longest: Duration::ZERO,
            buffer: vec![0; DATAGRAM_MAX + 1],
        })
    }

    fn node(&mut self, name: &str, resuming: bool) -> Result<NodeId, Box<dyn Error>> {
        self.sessions += 1;
        let session = NodeId(self.sessions);
        let credentials = Credentials {
            uid: 1,
            gid: 1,
            pid: 0,
        };
        self.feed(Input::Connected {
            session,
            credentials,
        })?;
        self.send(session, &hello(name, resuming))?;
        Ok(session)
    }

    fn send(&mut self, session: NodeId, frame: &ToManager) -> Done {
        let frame = encode_to_manager(frame);
        let datagram = Datagram::new(&frame);
        self.feed(Input::Datagram { session, datagram })
    }

    /// Feeds one input, and then all ticks that its work needs.
    fn feed(&mut self, input: Input<'_>) -> Done {
        self.piece(input)?;
        while self.machine.deadline() == Some(sm2_proto::Instant(0)) {
            self.piece(Input::Tick)?;
        }
        Ok(())
    }

    fn piece(&mut self, input: Input<'_>) -> Done {
        let before = processor_time()?;
        self.machine.handle(sm2_proto::Instant(0), input)?;
        let mut told = Vec::new();
        while let Some(output) = self.machine.poll() {
            match output {
                Output::Send { frame, .. } => self.wire.0.send(&[IoSlice::new(&frame)], &[])?,
                Output::Link { ends, .. } => {
                    let (one, other) = SeqPacket::pair()?;
                    for (end, (node, frame)) in [one, other].iter().zip(ends) {
                        let parts = [IoSlice::new(&frame)];
                        self.wire.0.send(&parts, &[end.as_fd()])?;
                        told.push(node);
                    }
                }
                Output::HangUp { cause, .. } => drop(format!("{cause:?}")),
                Output::KeepCounters { .. }
                | Output::SendCounters { .. }
                | Output::ReadAccessPolicy => {}
            }
        }
        self.longest = self.longest.max(processor_time()?.saturating_sub(before));
        while self.wire.1.recv(&mut self.buffer).is_ok() {}
        for session in told {
            if self.machine.awaits_room(session) {
                let drained = Input::Drained { session };
                self.machine.handle(sm2_proto::Instant(0), drained)?;
            }
        }
        Ok(())
    }
}

fn processor_time() -> nix::Result<Duration> {
    Ok(clock_gettime(ClockId::CLOCK_THREAD_CPUTIME_ID)?.into())
}

/// Declares beside busy processes, and compares that with an echo. The Manager has this nice value.
fn compare(nice: i32) -> Done {
    let folder = tempfile::tempdir()?;
    let path = folder.path().join("busy.sock");
    let shown = path.to_str().ok_or("the path is not text")?.to_owned();
    let manager = start_with(nice, &["manager", &shown], Stdio::null())?;
    let mut children = Children(vec![manager]);
    while SeqPacket::connect(&path).is_err() {
        thread::sleep(Duration::from_millis(10));
    }
    for at in 0..CROWDS {
        let name = format!("crowd-{at}");
        children
            .0
            .push(start(&["crowd", &shown, &name], Stdio::null())?);
    }
    for at in 0..CHURNERS {
        let name = format!("churn-{at}");
        children
            .0
            .push(start(&["churn", &shown, &name], Stdio::null())?);
    }
    let (ours, theirs) = SeqPacket::pair()?;
    children
        .0
        .push(start(&["echo"], Stdio::from(OwnedFd::from(theirs)))?);
    let mut echo = Peer::new(ours);
    let mut probe = Peer::new(SeqPacket::connect(&path)?);
    probe.send(&hello("probe", false))?;
    probe.next()?;
    thread::sleep(Duration::from_secs(1));
    let mut times = [const { Vec::new() }; 2];
    for interface in 1..=ROUNDS {
        let start = Clock::now();
        probe.send(&declare(interface, publisher("probe")))?;
        probe.next()?;
        times[0].push(start.elapsed());
        probe.send(&withdraw(interface))?;
        probe.next()?;
        let start = Clock::now();
        echo.bytes(&[7; 40])?;
        echo.receive()?;
        times[1].push(start.elapsed());
        thread::sleep(Duration::from_micros(500));
    }
    println!("Manager with nice {nice}, {CHURNERS} busy processes with {MATCHES} matches each");
    for (what, times) in ["DECLARE", "echo"].iter().zip(&mut times) {
        times.sort_unstable();
        let at = |percent: usize| times[times.len() * percent / 100];
        println!("  {what:<8} p50 {:>8.1?}  p99 {:>8.1?}", at(50), at(99));
    }
    Ok(())
}

/// Kills the processes when dropped.
struct Children(Vec<Child>);

impl Drop for Children {
    fn drop(&mut self) {
        for child in &mut self.0 {
            let _ = child.kill();
            let _ = child.wait();
        }
    }
}

fn start(arguments: &[&str], stdin: Stdio) -> std::io::Result<Child> {
    start_with(0, arguments, stdin)
}

fn start_with(nice: i32, arguments: &[&str], stdin: Stdio) -> std::io::Result<Child> {
    let program: PathBuf = std::env::current_exe()?;
    let mut command = Command::new("nice");
    command.args(["-n", &nice.to_string()]).arg(program);
    command.args(arguments).stdin(stdin).stderr(Stdio::null());
    command.spawn()
}

fn churn(path: &Path, name: &str) -> Done {
    let mut node = Peer::new(SeqPacket::connect(path)?);
    node.send(&hello(name, false))?;
    node.next()?;
    for interface in 1.. {
        node.send(&declare(interface, subscriber("t")))?;
        node.send(&withdraw(interface))?;
        while !matches!(node.next()?, ToNode::Withdrawn { .. }) {}
    }
    Ok(())
}

fn crowd(path: &Path, name: &str) -> Done {
    let mut node = Peer::new(SeqPacket::connect(path)?);
    node.send(&hello(name, false))?;
    for interface in 1..=MATCHES / CROWDS as u64 {
        node.send(&declare(interface, publisher("t")))?;
    }
    loop {
        if let ToNode::Unlink {
            interface,
            link,
            code,
        } = node.next()?
        {
            node.send(&ToManager::Unlinked {
                interface,
                link,
                code,
            })?;
        }
    }
}

fn echo() -> Done {
    let stdin = std::io::stdin().as_fd().try_clone_to_owned()?;
    let mut peer = Peer::new(SeqPacket::from_fd(stdin)?);
    loop {
        let (bytes, _) = peer.receive()?;
        peer.bytes(&bytes)?;
    }
}

/// A connection that waits until it can send or receive.
struct Peer {
    socket: SeqPacket,
    buffer: Vec<u8>,
}

impl Peer {
    fn new(socket: SeqPacket) -> Self {
        let buffer = vec![0; DATAGRAM_MAX + 1];
        Self { socket, buffer }
    }

    fn bytes(&mut self, bytes: &[u8]) -> Done {
        Ok(self.socket.send(&[IoSlice::new(bytes)], &[])?)
    }

    fn send(&mut self, frame: &ToManager) -> Done {
        self.bytes(&encode_to_manager(frame))
    }

    fn receive(&mut self) -> Result<(Vec<u8>, usize), Box<dyn Error>> {
        wait_readable(&[self.socket.as_fd()], None)?;
        let received = self.socket.recv(&mut self.buffer)?;
        Ok((self.buffer[..received.len].to_vec(), received.fds.len()))
    }

    fn next(&mut self) -> Result<ToNode, Box<dyn Error>> {
        let (bytes, fds) = self.receive()?;
        let datagram = Datagram {
            fds: &vec![FdFacts::default(); fds],
            ..Datagram::new(&bytes)
        };
        Ok(decode_to_node(&datagram).map_err(|it| format!("{it:?}"))?)
    }
}

fn hello(name: &str, resuming: bool) -> ToManager {
    ToManager::Hello {
        min_version: 1,
        max_version: 1,
        name: text(name),
        resuming,
    }
}

fn declare(interface: u64, contract: Contract) -> ToManager {
    ToManager::Declare {
        interface: InterfaceId(interface),
        contract,
    }
}

fn withdraw(interface: u64) -> ToManager {
    let interface = InterfaceId(interface);
    ToManager::Withdraw { interface }
}

fn publisher(topic: &str) -> Contract {
    let data = TypeId {
        name: text("Scan"),
        hash: 1,
    };
    let offer = OfferedQos::new(8);
    let topic = text(topic);
    Contract::Publisher { topic, data, offer }
}

fn subscriber(topic: &str) -> Contract {
    let demand = DemandedQos::new(8, 2);
    Contract::Subscriber {
        topic: text(topic),
        data: None,
        demand,
    }
}

fn text(name: &str) -> Name {
    Name::new(name).expect("it keeps to the grammar")
}
