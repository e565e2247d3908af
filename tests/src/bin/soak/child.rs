//! A process of the run, as the director sees it.

use std::{
    fmt,
    os::unix::process::CommandExt,
    path::Path,
    process::Command,
    thread,
    time::{Duration, Instant},
};

use nix::sys::signal::Signal;
use sm2_tests::{
    TIMEOUT,
    census::{Census, anonymous_kib},
    process::{Exit, Process, this_program},
    random::Random,
};

use crate::{
    report::Report,
    shortage::{Kind, Shortage},
    tally::Tally,
};

/// The run cannot continue. The report has the reason.
#[derive(Debug)]
pub(crate) struct Broken;

/// The resources of a process.
#[derive(Clone, Debug)]
pub(crate) struct Holds {
    pub(crate) census: Census,
    pub(crate) anonymous_kib: u64,
}

impl fmt::Display for Holds {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(
            f,
            "{}, {} KiB of private memory",
            self.census, self.anonymous_kib
        )
    }
}

/// The first line of each process with a role: its program and libraries are loaded. The loader of a program without
/// descriptors ends the process.
pub(crate) const STARTED: &str = "started";

/// A process with its role, which is killed with this.
pub(crate) struct Child {
    pub(crate) name: String,
    process: Process,
    /// Whether it has said [`STARTED`].
    has_started: bool,
    tally: Tally,
    stopped_until: Option<Instant>,
    shortage: Option<(Shortage, Instant)>,
    can_lack_addresses: bool,
}

/// The roles whose addresses may run short, in processes that do not start at once (`--go`). A Rust program
/// aborts without memory for its own values: servers and clients copy messages, and a process that starts
/// needs more than it has.
const ROLES_WITH_MAPPINGS: [&str; 3] = ["publisher", "subscriber", "late"];

/// A command that runs this program in a role, with an allocator whose memory can be checked.
pub(crate) fn command(role: &str) -> Command {
    let mut command = this_program(role);
    // The allocator returns freed memory to the system, so that memory which stays is in use.
    for variable in ["MALLOC_MMAP_THRESHOLD_", "MALLOC_TRIM_THRESHOLD_"] {
        command.env(variable, "65536");
    }
    command.env("MALLOC_ARENA_MAX", "2");
    // Ctrl-C is for the director alone. The kernel ends a stopped process of a group of its own
    // when the director ends.
    command.process_group(0);
    command
}

impl Child {
    /// Starts this program in a role, with a socket and further options.
    pub(crate) fn start(socket: &Path, role: &str, name: &str, options: &[&str]) -> Self {
        let mut command = command(role);
        command.arg("--socket").arg(socket).args(options);
        Self {
            can_lack_addresses: ROLES_WITH_MAPPINGS.contains(&role) && !options.contains(&"--go"),
            ..Self::spawn(name, command)
        }
    }

    /// Starts a [`command`].
    pub(crate) fn spawn(name: &str, command: Command) -> Self {
        Self {
            name: name.to_owned(),
            process: Process::start(command),
            has_started: false,
            tally: Tally::default(),
            stopped_until: None,
            shortage: None,
            can_lack_addresses: false,
        }
    }

    pub(crate) fn say(&mut self, line: &str) {
        self.process.say(line);
    }

    pub(crate) fn log_has(&self, text: &str) -> bool {
        self.process.stderr().contains(text)
    }

    pub(crate) const fn process(&mut self) -> &mut Process {
        &mut self.process
    }

    pub(crate) fn holds(&self) -> Holds {
        let pid = self.process.pid();
        Holds {
            census: Census::of(pid),
            anonymous_kib: anonymous_kib(pid).unwrap_or(0),
        }
    }

    /// Reads the lines that have arrived, and returns those that answer a command. Ends a stop and a
    /// shortage that are over.
    pub(crate) fn look(&mut self, report: &mut Report) -> Vec<String> {
        let now = Instant::now();
        if self.stopped_until.is_some_and(|until| until <= now) {
            self.resume();
        }
        if self
            .shortage
            .as_ref()
            .is_some_and(|(_, until)| *until <= now)
        {
            self.supply();
        }
        let mut answers = Vec::new();
        while let Some(line) = self.process.try_line() {
            let tally = line.strip_prefix("tally ").and_then(Tally::parse);
            if let Some(tally) = tally {
                report.add(&self.tally, &tally);
                self.tally = tally;
            } else if line == STARTED {
                self.has_started = true;
            } else if line.starts_with("wrong ") {
                report.wrong(&format!("{}: {line}", self.name));
            } else {
                answers.push(line);
            }
        }
        answers
    }

    /// Waits for the answer that begins with `word`, and returns the rest of its line.
    pub(crate) fn answer(&mut self, word: &str, report: &mut Report) -> Result<String, Broken> {
        let start = Instant::now();
        loop {
            let ended = self.process.has_ended();
            for answer in self.look(report) {
                if let Some(rest) = answer.strip_prefix(word) {
                    return Ok(rest.trim().to_owned());
                }
            }
            if ended || start.elapsed() > TIMEOUT {
                let state = if ended { "ended" } else { "does not answer" };
                report.error(&format!("{} {state}: {word} expected", self.name));
                report.wrong(&self.process.stderr());
                return Err(Broken);
            }
            thread::sleep(Duration::from_millis(1));
        }
    }

    /// Fails if the process has ended by itself.
    pub(crate) fn must_live(&mut self, report: &mut Report) -> Result<(), Broken> {
        if !self.process.has_ended() {
            return Ok(());
        }
        self.look(report);
        let log = self.process.stderr();
        report.error(&format!("{} ended: {log}", self.name));
        Err(Broken)
    }

    /// Stops the process for a time.
    pub(crate) fn stop(&mut self, length: Duration) {
        self.process.signal(Signal::SIGSTOP);
        self.stopped_until = Some(Instant::now() + length);
    }

    pub(crate) const fn is_stopped(&self) -> bool {
        self.stopped_until.is_some()
    }

    pub(crate) fn resume(&mut self) {
        if self.stopped_until.take().is_some() {
            self.process.resume();
        }
    }

    /// Begins a shortage for a time. Returns false if the process is already short of something, starts or has ended.
    pub(crate) fn shorten(&mut self, kind: Kind, length: Duration, random: &mut Random) -> bool {
        if self.shortage.is_some() || !self.has_started {
            return false;
        }
        let shortage = Shortage::begin(self.process.pid(), kind, random);
        self.shortage = shortage.map(|it| (it, Instant::now() + length));
        self.shortage.is_some()
    }

    pub(crate) const fn can_lack_addresses(&self) -> bool {
        self.can_lack_addresses
    }

    /// Ends the shortage.
    pub(crate) fn supply(&mut self) {
        // Another process may have the number of a process that has ended.
        if let Some((shortage, _)) = self.shortage.take()
            && !self.process.has_ended()
        {
            shortage.end();
        }
    }

    /// Ends stop and shortage.
    pub(crate) fn relieve(&mut self) {
        self.supply();
        self.resume();
    }

    /// Ends the process in order (SIGTERM).
    pub(crate) fn end(&mut self, report: &mut Report) {
        self.relieve();
        self.process.signal(Signal::SIGTERM);
        let exit = self.process.wait();
        if exit != Exit::Status(0) {
            let log = self.process.stderr();
            report.error(&format!("{} ended with {exit:?}: {log}", self.name));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_process_that_starts_runs_short_of_nothing() {
        let mut child = Child::spawn("a child", Command::new("cat"));
        let mut report = Report::new();
        let mut random = Random::new(1);
        let mut shorten = |child: &mut Child| {
            child.shorten(Kind::Descriptors, Duration::from_secs(3_600), &mut random)
        };
        assert!(!shorten(&mut child));
        child.say(STARTED);
        child.say("answer");
        child.answer("answer", &mut report).unwrap();
        assert!(shorten(&mut child));
        assert!(!shorten(&mut child), "it is short of descriptors already");
    }
}
