//! A process of the run, as the director sees it.

use std::{
    os::unix::process::CommandExt,
    path::Path,
    process::Command,
    thread,
    time::{Duration, Instant},
};

use sm2_tests::{
    TIMEOUT,
    census::{Census, anonymous_kib},
    process::Process,
};

use crate::{report::Report, tally::Tally};

/// The run cannot continue. The report has the reason.
#[derive(Debug)]
pub(crate) struct Broken;

/// The resources of a process.
#[derive(Clone, Debug)]
pub(crate) struct Holds {
    pub(crate) census: Census,
    pub(crate) anonymous_kib: u64,
}

/// A process with its role, which is killed with this.
pub(crate) struct Child {
    pub(crate) name: String,
    process: Process,
    tally: Tally,
    stopped_until: Option<Instant>,
}

impl Child {
    /// Starts this program in a role, with a socket and further options.
    pub(crate) fn start(socket: &Path, role: &str, name: &str, options: &[&str]) -> Self {
        let program = std::env::current_exe().expect("the path of this program");
        let mut command = Command::new(program);
        command.arg(role).arg("--socket").arg(socket).args(options);
        for variable in ["SM2_SOCKET", "SM2_DOMAIN", "SM2_LOG", "XDG_RUNTIME_DIR"] {
            command.env_remove(variable);
        }
        // Ctrl-C is for the director alone. The kernel ends a stopped process of a group of its own
        // when the director ends.
        command.process_group(0);
        Self {
            name: name.to_owned(),
            process: Process::start(command),
            tally: Tally::default(),
            stopped_until: None,
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

    /// Reads the lines that have arrived, and returns those that answer a command. Continues the
    /// process at the end of a stop.
    pub(crate) fn look(&mut self, report: &mut Report) -> Vec<String> {
        if self
            .stopped_until
            .is_some_and(|until| until <= Instant::now())
        {
            self.resume();
        }
        let mut answers = Vec::new();
        while let Some(line) = self.process.try_line() {
            let tally = line.strip_prefix("tally ").and_then(Tally::parse);
            if let Some(tally) = tally {
                report.add(&self.tally, &tally);
                self.tally = tally;
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
        self.process.signal(nix::sys::signal::Signal::SIGSTOP);
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
}
