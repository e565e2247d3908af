//! The process of a gateway, as the measurement sees it: it obeys lines and answers with lines.

use std::{
    io::{BufRead, BufReader, Write},
    path::Path,
    process::{Child, ChildStdin, ChildStdout, Command, Stdio},
    thread,
    time::Duration,
};

use nix::{
    sys::signal::{Signal, kill},
    unistd::Pid,
};
use sm2_lossy_link::Namespace;

use crate::Done;

pub(crate) struct Peer {
    child: Child,
    input: ChildStdin,
    output: BufReader<ChildStdout>,
    depth: u16,
}

impl Peer {
    pub(crate) fn start(folder: &Path, number: usize, host: &Namespace) -> Done<Self> {
        let program = std::env::current_exe()?;
        let number = number.to_string();
        let spawn = || {
            Command::new(program)
                .arg("gateway")
                .arg(folder)
                .arg(&number)
                .stdin(Stdio::piped())
                .stdout(Stdio::piped())
                .spawn()
        };
        let mut child = host.enter(spawn)??;
        let input = child.stdin.take().ok_or("no input")?;
        let output = BufReader::new(child.stdout.take().ok_or("no output")?);
        let mut peer = Self {
            child,
            input,
            output,
            depth: 1,
        };
        peer.say("ready")?;
        Ok(peer)
    }

    /// Says a line, and returns the answer.
    pub(crate) fn say(&mut self, line: &str) -> Done<String> {
        if let Some(depth) = line.strip_prefix("subscribe ") {
            self.depth = depth.parse()?;
        }
        writeln!(self.input, "{line}")?;
        let mut answer = String::new();
        self.output.read_line(&mut answer)?;
        match answer.trim_end() {
            "" => Err(format!("no answer to `{line}`").into()),
            answer => Ok(answer.to_owned()),
        }
    }

    pub(crate) const fn depth(&self) -> u16 {
        self.depth
    }

    /// The number of messages that were published, or that arrived.
    pub(crate) fn count(&mut self) -> Done<u64> {
        Ok(self.say("count")?.parse()?)
    }

    pub(crate) fn until_linked(&mut self) -> Done {
        self.until("linked")
    }

    pub(crate) fn until_connected(&mut self) -> Done {
        self.until("connected")
    }

    fn until(&mut self, what: &str) -> Done {
        for _ in 0..3_000 {
            if self.say(what)? == "true" {
                return Ok(());
            }
            thread::sleep(Duration::from_millis(10));
        }
        Err(format!("not {what} in 30 s").into())
    }

    pub(crate) fn stop(&self) -> Done {
        self.signal(Signal::SIGSTOP)
    }

    pub(crate) fn go_on(&self) -> Done {
        self.signal(Signal::SIGCONT)
    }

    fn signal(&self, signal: Signal) -> Done {
        Ok(kill(Pid::from_raw(self.child.id().try_into()?), signal)?)
    }
}

impl Drop for Peer {
    fn drop(&mut self) {
        // The process may have ended already.
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}
