//! The processes of one case: starts them, reads their output, measures them, and ends them.

use std::{
    collections::VecDeque,
    fs::{self, File},
    io::{self, BufRead, BufReader, Write},
    net::TcpListener,
    path::PathBuf,
    process::{Child, ChildStdin, Command, Stdio},
    sync::{
        OnceLock,
        atomic::{AtomicU64, Ordering},
        mpsc::{self, Receiver, RecvTimeoutError, Sender},
    },
    thread,
    time::{Duration, Instant},
};

use nix::unistd::Pid;
use tempfile::TempDir;

use crate::{
    interrupt,
    job::{Cores, Domain, Job, Outcome, ProcessEvent, ROLE_COMMAND, Role, Side},
    leftovers::Leftovers,
    link::Link,
    measure,
    peers::{Family, PeerInfo, catalogue, python},
};

pub use failure::Failure;

mod failure;

/// The longest time for setting up, and for ending.
pub const TIMEOUT: Duration = Duration::from_secs(30);

/// How often the director checks whether the run was interrupted.
const LOOK: Duration = Duration::from_millis(200);

/// The processes of one case, and the folder and networks that they share.
pub struct World {
    domain: Domain,
    /// The network namespaces of the near and the far host, if there are two hosts.
    networks: Option<[PathBuf; 2]>,
    dir: TempDir,
    processes: Vec<Process>,
    events: Receiver<(usize, Option<ProcessEvent>)>,
    sender: Sender<(usize, Option<ProcessEvent>)>,
    // Removes the files that are left when all processes have ended.
    leftovers: Leftovers,
}

struct Process {
    is_daemon: bool,
    side: Side,
    name: String,
    child: Child,
    stdin: Option<ChildStdin>,
    stderr: PathBuf,
    reported: VecDeque<Option<ProcessEvent>>,
}

/// The index of a process of a world.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ProcessId(usize);

/// The assignment of this run's processes to cores.
static CORES: OnceLock<Cores> = OnceLock::new();

/// Sets the cores of all processes. Call it once, before the first world.
pub fn place(cores: Cores) {
    // A second call has no effect: processes already run on the cores of the first one.
    let _ = CORES.set(cores);
}

/// The core of a process; `number` counts the processes that are not daemons.
fn core(cores: Cores, number: usize, available: usize) -> Option<usize> {
    match cores {
        Cores::Free => None,
        Cores::Apart => Some(number % available.max(1)),
        Cores::Together => Some(0),
    }
}

/// The number of worlds that this director has made.
static WORLDS: AtomicU64 = AtomicU64::new(0);

impl World {
    /// Makes a world of one host, and starts the peer's daemon if it has one.
    ///
    /// # Errors
    ///
    /// See [`Failure`].
    pub fn new(peer: &PeerInfo) -> Result<Self, Failure> {
        Self::of(peer, None)
    }

    /// Makes a world of two hosts, and starts the peer's daemon at each of them if it has one. The
    /// link must outlive the world.
    ///
    /// # Errors
    ///
    /// See [`Failure`].
    pub fn across(peer: &PeerInfo, link: &Link) -> Result<Self, Failure> {
        let networks = [Side::Near, Side::Far].map(|side| link.network(side));
        Self::of(peer, Some(networks))
    }

    fn of(peer: &PeerInfo, networks: Option<[PathBuf; 2]>) -> Result<Self, Failure> {
        let dir = tempfile::Builder::new()
            .prefix("sm2-bench-")
            .tempdir_in("/dev/shm")
            .map_err(Failure::io("make a folder in /dev/shm"))?;
        let number = WORLDS.fetch_add(1, Ordering::Relaxed);
        let tag = format!("sm2bench{}x{number}_", std::process::id());
        let port = free_port().map_err(Failure::io("find a free TCP port"))?;
        let (sender, events) = mpsc::channel();
        let mut world = Self {
            domain: Domain {
                peer: peer.name.to_owned(),
                dir: dir.path().to_owned(),
                tag: tag.clone(),
                port,
                side: None,
            },
            networks,
            leftovers: Leftovers::before(tag),
            dir,
            processes: Vec::new(),
            events,
            sender,
        };
        let daemons: &[_] = match (peer.daemon, &world.networks) {
            (false, _) => &[],
            (true, None) => &[("daemon", Side::Near)],
            // The far daemon starts first: the near one connects to it.
            (true, Some(_)) => &[("daemon-far", Side::Far), ("daemon-near", Side::Near)],
        };
        for &(name, side) in daemons {
            let daemon = world.start_at(side, name, Role::Daemon)?;
            world.ready(daemon)?;
        }
        Ok(world)
    }

    /// Starts a process, at the near host if there are two hosts.
    ///
    /// # Errors
    ///
    /// See [`Failure`].
    pub fn start(&mut self, name: &str, role: Role) -> Result<ProcessId, Failure> {
        self.start_at(Side::Near, name, role)
    }

    /// Starts a process at a host.
    ///
    /// # Errors
    ///
    /// See [`Failure`].
    pub fn start_at(&mut self, side: Side, name: &str, role: Role) -> Result<ProcessId, Failure> {
        let failed = Failure::io("start a process of the run");
        self.spawn(side, name, role).map_err(failed)
    }

    fn spawn(&mut self, side: Side, name: &str, role: Role) -> io::Result<ProcessId> {
        let network = self.networks.as_ref().map(|[near, far]| match side {
            Side::Near => near.clone(),
            Side::Far => far.clone(),
        });
        let domain = Domain {
            side: network.is_some().then_some(side),
            ..self.domain.clone()
        };
        let others = self.processes.iter();
        let number = others.filter(|other| !other.is_daemon).count();
        let is_daemon = matches!(role, Role::Daemon);
        let cores = CORES.get().copied().filter(|_| !is_daemon);
        let available = thread::available_parallelism().map_or(1, usize::from);
        let core = core(cores.unwrap_or_default(), number, available);
        let job = serde_json::to_string(&Job {
            domain,
            role,
            core,
            network,
        })?;
        let stderr = self.dir.path().join(format!("{name}.stderr"));
        let mut command = match catalogue::family(&self.domain.peer) {
            Some(Family::Python) if !is_daemon => python::command().map_err(io::Error::other)?,
            _ => {
                let mut itself = Command::new(std::env::current_exe()?);
                itself.arg(ROLE_COMMAND);
                itself
            }
        };
        let mut child = command
            .arg(&job)
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .stderr(File::create(&stderr)?)
            .spawn()?;
        let id = self.processes.len();
        let stdin = child.stdin.take();
        let stdout = child.stdout.take();
        self.processes.push(Process {
            is_daemon,
            side,
            name: name.to_owned(),
            child,
            stdin,
            stderr,
            reported: VecDeque::new(),
        });
        let sender = self.sender.clone();
        thread::Builder::new().spawn(move || {
            for line in stdout
                .into_iter()
                .flat_map(|out| BufReader::new(out).lines())
            {
                let Ok(line) = line else { break };
                // Libraries may print other lines.
                if let Ok(event) = serde_json::from_str(&line)
                    && sender.send((id, Some(event))).is_err()
                {
                    return;
                }
            }
            // An error means that the director has dropped this world.
            let _ = sender.send((id, None));
        })?;
        Ok(ProcessId(id))
    }

    /// Sends a word to a process. If the process has ended, [`next_event`](Self::next_event) reports that.
    pub fn send_word(&mut self, process: ProcessId, word: &str) {
        if let Some(stdin) = &mut self.processes[process.0].stdin {
            let _ = writeln!(stdin, "{word}");
        }
    }

    /// Closes the standard input of a process, which makes it exit.
    pub fn end(&mut self, process: ProcessId) {
        self.processes[process.0].stdin = None;
    }

    /// Waits for the next line of a process, at most `limit`.
    ///
    /// # Errors
    ///
    /// See [`Failure`].
    pub fn next_event(
        &mut self,
        process: ProcessId,
        action: &'static str,
        limit: Duration,
    ) -> Result<ProcessEvent, Failure> {
        let until = Instant::now() + limit;
        loop {
            match self.processes[process.0].reported.pop_front() {
                Some(Some(ProcessEvent::Failed { reason })) => {
                    let process = self.processes[process.0].name.clone();
                    return Err(Failure::Reported { process, reason });
                }
                Some(Some(event)) => return Ok(event),
                Some(None) => return Err(self.ended(process)),
                None => {}
            }
            let left = until.saturating_duration_since(Instant::now());
            match self.events.recv_timeout(left.min(LOOK)) {
                Ok((id, event)) => self.note(id, event)?,
                Err(_) if interrupt::came() => return Err(Failure::Interrupted),
                Err(RecvTimeoutError::Timeout) if left > LOOK => {}
                Err(RecvTimeoutError::Timeout | RecvTimeoutError::Disconnected) => {
                    let process = &self.processes[process.0];
                    return Err(Failure::TimedOut {
                        process: process.name.clone(),
                        action,
                        limit,
                        stderr: tail(&process.stderr),
                    });
                }
            }
        }
    }

    /// Sleeps for this time while the processes run.
    ///
    /// # Errors
    ///
    /// See [`Failure`].
    pub fn let_run(&mut self, time: Duration) -> Result<(), Failure> {
        let until = Instant::now() + time;
        loop {
            let left = until.saturating_duration_since(Instant::now());
            match self.events.recv_timeout(left.min(LOOK)) {
                Ok((id, event)) => self.note(id, event)?,
                Err(_) if interrupt::came() => return Err(Failure::Interrupted),
                Err(_) if left.is_zero() => return Ok(()),
                Err(_) => {}
            }
        }
    }

    /// Keeps the line of a process for [`next_event`](Self::next_event). A failure of any process fails the case.
    fn note(&mut self, id: usize, event: Option<ProcessEvent>) -> Result<(), Failure> {
        let process = &mut self.processes[id];
        match event {
            Some(ProcessEvent::Failed { reason }) => Err(Failure::Reported {
                process: process.name.clone(),
                reason,
            }),
            // The process has ended although its standard input is open.
            None if process.stdin.is_some() => Err(self.ended(ProcessId(id))),
            event => {
                process.reported.push_back(event);
                Ok(())
            }
        }
    }

    fn ended(&mut self, process: ProcessId) -> Failure {
        let process = &mut self.processes[process.0];
        let status = match process.child.wait() {
            Ok(status) => status.to_string(),
            Err(error) => error.to_string(),
        };
        Failure::Ended {
            process: process.name.clone(),
            status,
            stderr: tail(&process.stderr),
        }
    }

    /// Waits for exactly this line of a process.
    ///
    /// # Errors
    ///
    /// See [`Failure`].
    pub fn expect(
        &mut self,
        process: ProcessId,
        expected: &ProcessEvent,
        action: &'static str,
        limit: Duration,
    ) -> Result<(), Failure> {
        match self.next_event(process, action, limit)? {
            event if event == *expected => Ok(()),
            event => Err(self.unexpected(process, event, action)),
        }
    }

    fn unexpected(&self, process: ProcessId, event: ProcessEvent, action: &'static str) -> Failure {
        Failure::Unexpected {
            process: self.processes[process.0].name.clone(),
            event: Box::new(event),
            action,
        }
    }

    /// Waits until a process is ready.
    ///
    /// # Errors
    ///
    /// See [`Failure`].
    pub fn ready(&mut self, process: ProcessId) -> Result<(), Failure> {
        self.expect(process, &ProcessEvent::Ready, "set up", TIMEOUT)
    }

    /// Waits for the results of a process.
    ///
    /// # Errors
    ///
    /// See [`Failure`].
    pub fn outcome(&mut self, process: ProcessId, limit: Duration) -> Result<Outcome, Failure> {
        let action = "report its results";
        match self.next_event(process, action, limit)? {
            ProcessEvent::Done(outcome) => Ok(outcome),
            event => Err(self.unexpected(process, event, action)),
        }
    }

    /// The CPU time of all processes so far, in nanoseconds.
    ///
    /// # Errors
    ///
    /// A process has ended.
    pub fn cpu_ns(&self) -> Result<u64, Failure> {
        sum(&self.processes, measure::cpu_ns)
    }

    /// The CPU time of all processes of a host so far, in nanoseconds.
    ///
    /// # Errors
    ///
    /// A process has ended.
    pub fn cpu_ns_at(&self, side: Side) -> Result<u64, Failure> {
        let there = self.processes.iter().filter(|it| it.side == side);
        sum(there, measure::cpu_ns)
    }

    /// The memory of all processes, in bytes.
    ///
    /// # Errors
    ///
    /// A process has ended.
    pub fn pss_bytes(&self) -> Result<u64, Failure> {
        sum(&self.processes, measure::pss_bytes)
    }

    /// The number of times that threads of all processes have gone to sleep so far.
    ///
    /// # Errors
    ///
    /// A process has ended.
    pub fn sleeps(&self) -> Result<u64, Failure> {
        sum(&self.processes, measure::sleeps)
    }
}

fn sum<'a>(
    processes: impl IntoIterator<Item = &'a Process>,
    of: impl Fn(Pid) -> io::Result<u64>,
) -> Result<u64, Failure> {
    let pids = processes
        .into_iter()
        .map(|process| Pid::from_raw(process.child.id() as i32));
    let sum: io::Result<u64> = pids.map(of).sum();
    sum.map_err(Failure::io("measure a process"))
}

impl Drop for World {
    /// Ends all processes, the daemons last.
    fn drop(&mut self) {
        for process in self.processes.iter_mut().rev() {
            process.stdin = None;
        }
        let until = Instant::now() + Duration::from_secs(2);
        for process in self.processes.iter_mut().rev() {
            // Most processes exit by themselves within this time.
            while Instant::now() < until && matches!(process.child.try_wait(), Ok(None)) {
                thread::sleep(Duration::from_millis(2));
            }
            // The process may have exited in the meantime; `wait` reaps it in either case.
            let _ = process.child.kill();
            let _ = process.child.wait();
        }
        self.leftovers.remove();
    }
}

/// The last line that a process wrote to standard error.
fn tail(path: &PathBuf) -> String {
    let text = fs::read(path).unwrap_or_default();
    let text = String::from_utf8_lossy(&text);
    let line = text.lines().rev().find(|line| !line.trim().is_empty());
    let line = line.unwrap_or_default().trim();
    line.chars().take(300).collect()
}

fn free_port() -> io::Result<u16> {
    Ok(TcpListener::bind(("127.0.0.1", 0))?.local_addr()?.port())
}

#[cfg(test)]
mod tests;
