//! The demo from its first process to its report.

use std::{
    env,
    os::fd::AsFd,
    path::Path,
    process::{self, Command},
    time::{Duration, Instant},
};

use sm2_manager::{Background, Options};

use super::{
    Arguments, PART,
    child::{Child, Outcome, Part, Stage},
    folder,
    meter::Meter,
    report::{self, Report},
    screen::Screen,
};
use crate::{
    Ended,
    error::CliError,
    interrupt::{Interrupt, Stopped},
    wait::{For, wait},
};

/// How long starting all processes, and ending them, may take.
const PATIENCE: Duration = Duration::from_secs(30);

/// How often figures are shown.
const TICK: Duration = Duration::from_secs(1);

/// The first ones are shown a little later, when all parts have said theirs.
const DELAY: Duration = Duration::from_millis(100);

/// Runs the demo: `count` messages.
///
/// # Errors
///
/// As [`super::run`].
pub(super) fn direct(arguments: &Arguments, count: u64) -> Result<Ended, CliError> {
    let interrupt = Interrupt::install().map_err(CliError::system("catch signals"))?;
    let folder = folder::private()?;
    let socket = folder.path().join(folder::SOCKET);
    let _manager = Background::start(&socket, Options::default())?;
    let mut director = Director {
        arguments,
        count,
        socket: &socket,
        interrupt,
        heeded: None,
        children: Vec::new(),
        screen: Screen::new(arguments.json),
    };
    director.gather()?;
    // Nobody else connects: whatever ends the demo, it leaves nothing behind.
    drop(folder);
    if let Some(signal) = director.heeded {
        return Ok(Ended::Stopped(signal));
    }
    let report = director.play()?;
    director.screen.report(&report)?;
    match (report::verdict(&director.outcomes()), director.heeded) {
        // Stopped before its first message.
        (Ok(()) | Err(CliError::NothingReceived { .. }), Some(signal)) => {
            Ok(Ended::Stopped(signal))
        }
        (verdict, _) => verdict.map(|()| Ended::Done),
    }
}

struct Director<'a> {
    arguments: &'a Arguments,
    count: u64,
    socket: &'a Path,
    interrupt: Interrupt,
    /// The signal that was seen, and is obeyed.
    heeded: Option<Stopped>,
    /// The publisher, once all subscribers are there, comes last.
    children: Vec<Child>,
    screen: Screen,
}

impl Director<'_> {
    /// Starts all processes; returns when all are ready, or a signal came.
    fn gather(&mut self) -> Result<(), CliError> {
        let Arguments {
            subscribers,
            rate,
            integrity,
            ..
        } = self.arguments;
        let (size, seconds) = (self.arguments.size(), self.arguments.seconds());
        self.screen.announce(&format!(
            "1 publisher, {subscribers} subscribers: {size} at {rate} Hz for {seconds} s, {}; \
             every byte is checked",
            integrity.as_str(),
        ))?;
        for number in 1..=*subscribers {
            self.start(Part::Subscriber(number))?;
        }
        self.await_ready()?;
        if self.heeded.is_none() {
            self.start(Part::Publisher)?;
            self.await_ready()?;
        }
        Ok(())
    }

    fn start(&mut self, part: Part) -> Result<(), CliError> {
        let itself = env::current_exe().map_err(CliError::system("find the program sm2"))?;
        let (role, name) = match part {
            Part::Publisher => ("publisher", "publisher".to_owned()),
            Part::Subscriber(number) => ("subscriber", format!("subscriber-{number}")),
        };
        let mut command = Command::new(itself);
        command
            .args([PART, role, "--name", &name, "--socket"])
            .arg(self.socket)
            .args(["--size", &self.arguments.size().0.to_string()])
            .args(["--period", &self.arguments.period().as_nanos().to_string()])
            .args(["--count", &self.count.to_string()])
            .args(["--subscribers", &self.arguments.subscribers.to_string()])
            .args(["--integrity", self.arguments.integrity.as_str()]);
        let child = Child::start(part, &mut command)
            .map_err(CliError::system("start a process of the demo"))?;
        self.children.push(child);
        Ok(())
    }

    fn await_ready(&mut self) -> Result<(), CliError> {
        let until = Instant::now() + PATIENCE;
        while self.heeded.is_none() && self.any(|stage| *stage == Stage::Starting) {
            self.listen(until)?;
            let late = Instant::now() >= until;
            for child in &self.children {
                let reason = match child.stage() {
                    Stage::Failed(reason) => reason.clone(),
                    Stage::Starting if late => "does not start".to_owned(),
                    _ => continue,
                };
                let part = child.part().to_string();
                return Err(CliError::PartFailed { part, reason });
            }
        }
        Ok(())
    }

    /// Publishes, watches, and ends the processes.
    fn play(&mut self) -> Result<Report, CliError> {
        let pids = self.children.iter().map(Child::pid);
        let mut meter = Meter::start(pids.chain([process::id()]).collect());
        let mut tick = Instant::now() + TICK + DELAY;
        self.publisher(Child::begin);
        while self.is_publishing() {
            self.listen(tick)?;
            if self.heeded.is_some() {
                self.publisher(Child::end);
            }
            if Instant::now() >= tick {
                tick += TICK;
                let costs = meter.look();
                self.screen.show(&self.children, &meter, &costs)?;
            }
        }
        // While all memory is still there.
        meter.look();
        self.dismiss()?;
        Ok(Report::new(
            self.arguments.size().0,
            self.arguments.integrity,
            &self.outcomes(),
            meter.total(),
            self.heeded.is_some(),
        ))
    }

    /// Ends the subscribers, who then report.
    fn dismiss(&mut self) -> Result<(), CliError> {
        let until = Instant::now() + PATIENCE;
        self.children.iter_mut().for_each(Child::end);
        while self.any(|stage| *stage == Stage::Ready) && Instant::now() < until {
            self.listen(until)?;
        }
        Ok(())
    }

    /// Waits until a process says something, a signal comes, or `until`.
    fn listen(&mut self, until: Instant) -> Result<(), CliError> {
        let voices = self.children.iter().filter_map(Child::voice);
        let mut fds: Vec<_> = voices.map(|fd| (fd, For::Reading)).collect();
        if self.heeded.is_none() {
            fds.push((self.interrupt.as_fd(), For::Reading));
        }
        let timeout = until.saturating_duration_since(Instant::now());
        let ready = wait(&fds, Some(timeout)).map_err(CliError::system("wait for the demo"))?;
        let speakers = self.children.iter_mut().filter(|it| it.voice().is_some());
        for (child, _) in speakers.zip(ready).filter(|(_, ready)| *ready) {
            child.listen();
        }
        self.heeded = self.interrupt.signal();
        Ok(())
    }

    fn outcomes(&self) -> Vec<Outcome<'_>> {
        self.children.iter().map(Child::outcome).collect()
    }

    fn any(&self, is: impl Fn(&Stage) -> bool) -> bool {
        self.children.iter().any(|child| is(child.stage()))
    }

    /// Until the publisher is done, as long as anybody receives.
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
