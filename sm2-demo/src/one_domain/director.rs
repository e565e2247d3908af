//! Starts the processes of the demo, shows their figures, and writes the report.

use std::{
    env,
    io::Write,
    os::fd::BorrowedFd,
    path::Path,
    process::{self, Command},
    time::{Duration, Instant},
};

use sm2_manager::Background;
use sm2_proto::text::Counted;

use super::{
    child::{Child, Outcome, Part, Stage},
    command_line::COMMAND,
    meter::Meter,
    report::{self, Report},
    screen::Screen,
};
use crate::{
    error::DemoError,
    folder,
    options::{Ending, Options},
    output::{integrity, size_text},
    waiting::readable,
};

/// Timeout for starting all processes, and for ending them.
const TIMEOUT: Duration = Duration::from_secs(30);

/// How often figures are shown.
const TICK: Duration = Duration::from_secs(1);

/// A delay before the figures are shown, so that all processes have reported theirs.
const DELAY: Duration = Duration::from_millis(100);

/// Runs the demo in `out`. It ends early when `stop` becomes readable, and then reports what it has.
///
/// # Errors
///
/// See [`DemoError`].
pub fn run(
    options: &Options,
    out: &mut dyn Write,
    stop: BorrowedFd<'_>,
) -> Result<Ending, DemoError> {
    options.check_memory()?;
    let count = options.count()?;
    let folder = folder::private()?;
    let socket = folder.path().join(folder::SOCKET);
    let _manager =
        Background::start(&socket, sm2_manager::Options::default()).map_err(DemoError::Manager)?;
    let mut director = Director {
        options,
        count,
        socket: &socket,
        stop,
        is_stopped: false,
        children: Vec::new(),
        screen: Screen::new(out, options.format),
    };
    director.gather()?;
    // All processes have connected. Removing the folder now means that nothing is left if the demo is
    // killed.
    drop(folder);
    if director.is_stopped {
        return Ok(Ending::Stopped);
    }
    let report = director.play()?;
    director.screen.report(&report)?;
    match (report::verdict(&director.outcomes()), director.is_stopped) {
        // The demo was stopped before the first message.
        (Ok(()) | Err(DemoError::NothingReceived { .. }), true) => Ok(Ending::Stopped),
        (verdict, _) => verdict.map(|()| Ending::Complete),
    }
}

struct Director<'a> {
    options: &'a Options,
    count: u64,
    socket: &'a Path,
    stop: BorrowedFd<'a>,
    /// True when `stop` has become readable.
    is_stopped: bool,
    /// The subscribers, then the publisher, which starts when they are ready.
    children: Vec<Child>,
    screen: Screen<'a>,
}

impl Director<'_> {
    /// Starts all processes; returns when all are ready, or on a signal.
    fn gather(&mut self) -> Result<(), DemoError> {
        let Options {
            subscribers,
            size_bytes,
            rate_hz,
            seconds,
            is_sealed,
            ..
        } = self.options;
        self.screen.announce(&format!(
            "1 publisher, {}: {} at {rate_hz} Hz for {seconds} s, {}; \
             every byte is checked",
            Counted::new(u64::from(*subscribers), "subscriber"),
            size_text(*size_bytes),
            integrity(*is_sealed),
        ))?;
        for number in 1..=*subscribers {
            self.start(Part::Subscriber(number))?;
        }
        self.await_ready()?;
        if !self.is_stopped {
            self.start(Part::Publisher)?;
            self.await_ready()?;
        }
        Ok(())
    }

    fn start(&mut self, part: Part) -> Result<(), DemoError> {
        let itself = env::current_exe().map_err(DemoError::system("find the program sm2"))?;
        let (role, name) = match part {
            Part::Publisher => ("publisher", "publisher".to_owned()),
            Part::Subscriber(number) => ("subscriber", format!("subscriber-{number}")),
        };
        let mut command = Command::new(itself);
        command
            .args([COMMAND, role, "--name", &name, "--socket"])
            .arg(self.socket)
            .args(["--size", &self.options.size_bytes.to_string()])
            .args(["--period", &self.options.period().as_nanos().to_string()])
            .args(["--count", &self.count.to_string()])
            .args(["--subscribers", &self.options.subscribers.to_string()])
            .args(self.options.is_sealed.then_some("--sealed"));
        let child = Child::start(part, &mut command)
            .map_err(DemoError::system("start a process of the demo"))?;
        self.children.push(child);
        Ok(())
    }

    fn await_ready(&mut self) -> Result<(), DemoError> {
        let until = Instant::now() + TIMEOUT;
        while !self.is_stopped && self.any(|stage| *stage == Stage::Starting) {
            self.listen(until)?;
            let late = Instant::now() >= until;
            for child in &self.children {
                let reason = match child.stage() {
                    Stage::Failed(reason) => reason.clone(),
                    Stage::Starting if late => "does not start".to_owned(),
                    _ => continue,
                };
                let part = child.part().to_string();
                return Err(DemoError::PartFailed { part, reason });
            }
        }
        Ok(())
    }

    /// Lets the publisher publish, shows figures, and ends the processes.
    fn play(&mut self) -> Result<Report, DemoError> {
        let pids = self.children.iter().map(Child::pid);
        let mut meter = Meter::start(pids.chain([process::id()]).collect());
        let mut tick = Instant::now() + TICK + DELAY;
        self.publisher(Child::begin);
        while self.is_publishing() {
            self.listen(tick)?;
            if self.is_stopped {
                self.publisher(Child::end);
            }
            if Instant::now() >= tick {
                tick += TICK;
                let costs = meter.measure();
                self.screen.show(&self.children, &meter, &costs)?;
            }
        }
        // Before the processes end and release their memory.
        meter.measure();
        self.dismiss()?;
        Ok(Report::new(
            self.options.size_bytes,
            self.options.is_sealed,
            &self.outcomes(),
            meter.total(),
            self.is_stopped,
        ))
    }

    /// Ends the subscribers, which then report their totals.
    fn dismiss(&mut self) -> Result<(), DemoError> {
        let until = Instant::now() + TIMEOUT;
        self.children.iter_mut().for_each(Child::end);
        while self.any(|stage| *stage == Stage::Ready) && Instant::now() < until {
            self.listen(until)?;
        }
        Ok(())
    }

    /// Waits for a line of a process, a signal, or the time `until`.
    fn listen(&mut self, until: Instant) -> Result<(), DemoError> {
        let mut fds: Vec<_> = self.children.iter().filter_map(Child::output_fd).collect();
        if !self.is_stopped {
            fds.push(self.stop);
        }
        let timeout = until.saturating_duration_since(Instant::now());
        let mut ready = readable(&fds, Some(timeout))?;
        if !self.is_stopped {
            self.is_stopped = ready.pop() == Some(true);
        }
        let running = self
            .children
            .iter_mut()
            .filter(|it| it.output_fd().is_some());
        for (child, _) in running.zip(ready).filter(|(_, ready)| *ready) {
            child.read_output();
        }
        Ok(())
    }

    fn outcomes(&self) -> Vec<Outcome<'_>> {
        self.children.iter().map(Child::outcome).collect()
    }

    fn any(&self, is: impl Fn(&Stage) -> bool) -> bool {
        self.children.iter().any(|child| is(child.stage()))
    }

    /// True until the publisher is done, or no subscriber is left.
    fn is_publishing(&self) -> bool {
        let ready = |child: &Child| *child.stage() == Stage::Ready;
        let (publisher, mut subscribers) =
            (self.children.last(), self.children.iter().rev().skip(1));
        publisher.is_some_and(ready) && subscribers.any(ready)
    }

    fn publisher(&mut self, tell: impl Fn(&mut Child)) {
        if let Some(publisher) = self.children.last_mut() {
            tell(publisher);
        }
    }
}

#[cfg(test)]
mod tests;
