//! Gateways in separate processes.

use std::{
    fs,
    io::{BufRead, BufReader},
    net::SocketAddr,
    path::Path,
    process::{Child, Command, Stdio},
    sync::mpsc,
    thread,
};

use sm2_test_support::SOON;

const PROGRAM: &str = env!("CARGO_BIN_EXE_sm2-gateway");

/// A gateway in a separate process, which is killed when the test ends.
pub(crate) struct Process(Child);

impl Process {
    pub(crate) fn start(config: &Path) -> Self {
        let mut command = Command::new(PROGRAM);
        let command = command.arg("run").arg(config);
        let command = command.stdout(Stdio::null()).stderr(Stdio::null());
        Self(command.spawn().unwrap())
    }

    /// Starts a gateway, and returns the address of its socket, which it logs by default.
    pub(crate) fn listening(config: &Path) -> (Self, SocketAddr) {
        Self::listening_as(&mut Command::new(PROGRAM), config)
    }

    /// The same, with so many descriptors at most: the soft and the hard limit.
    pub(crate) fn with_limits(config: &Path, soft: u64, hard: u64) -> (Self, SocketAddr) {
        let mut command = Command::new("sh");
        let script = format!("ulimit -Sn {soft} && ulimit -Hn {hard} && exec \"$0\" \"$@\"");
        Self::listening_as(command.args(["-c", &script, PROGRAM]), config)
    }

    fn listening_as(command: &mut Command, config: &Path) -> (Self, SocketAddr) {
        let command = command.arg("run").arg(config).env_remove("SM2_LOG");
        let command = command.stdout(Stdio::null()).stderr(Stdio::piped());
        let mut child = command.spawn().unwrap();
        let log = BufReader::new(child.stderr.take().unwrap());
        let process = Self(child);
        let (found, addresses) = mpsc::channel();
        // Reads to the end, so that the process can log more.
        thread::spawn(move || {
            for line in log.lines().map_while(Result::ok) {
                let mut words = line.split(' ');
                let address = words.find_map(|it| it.strip_prefix("address="));
                // Nobody needs a second one.
                let _ = address.map(|it| found.send(it.parse().unwrap()));
            }
        });
        let address = addresses.recv_timeout(SOON).expect("a log of the address");
        (process, address)
    }

    /// The number of the process.
    pub(crate) fn id(&self) -> u32 {
        self.0.id()
    }

    /// The number of open descriptors.
    pub(crate) fn descriptors(&self) -> usize {
        fs::read_dir(format!("/proc/{}/fd", self.0.id()))
            .unwrap()
            .count()
    }

    /// Kills the process with SIGKILL.
    pub(crate) fn kill(mut self) {
        self.0.kill().unwrap();
        assert!(!self.0.wait().unwrap().success());
    }

    /// The value of a line of `/proc/PID/status`.
    pub(crate) fn status(&self, line: &str) -> String {
        let status = fs::read_to_string(format!("/proc/{}/status", self.0.id())).unwrap();
        let value = status.lines().find_map(|it| it.strip_prefix(line));
        value.unwrap().trim().to_owned()
    }

    /// The bytes of memory that the process has for itself, in RAM or swapped. The pages of its program do not count:
    /// the kernel reads and drops them as it likes.
    pub(crate) fn private_bytes(&self) -> usize {
        let kib = |line| {
            let value = self.status(line);
            let kib = value.split_whitespace().next().unwrap();
            kib.parse::<usize>().unwrap()
        };
        (kib("RssAnon:") + kib("VmSwap:")) << 10
    }
}

impl Drop for Process {
    fn drop(&mut self) {
        // The process may have ended already.
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}
