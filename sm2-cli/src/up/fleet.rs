//! The programs of a robot, and the state of each.

use std::{
    io,
    ops::RangeBounds,
    os::fd::{AsFd, BorrowedFd},
    path::Path,
    time::Duration,
};

use nix::sys::signal::Signal;
use sm2_io::clock;
use sm2_proto::{Instant, domain::Domain, text::Counted};

use super::{
    guard::Guard,
    limits::KILL_TIMEOUT,
    process::{Exit, Process, reap},
    restarts::{Next, Restarts},
    robot::Program,
    show::{Kind, Show},
    waiting::Waiting,
};
use crate::{time::Span, wait::For};

/// The programs, from the first that is started to the last.
pub(super) struct Fleet<'a> {
    pub(super) show: Show,
    guard: Guard,
    socket: &'a Path,
    stop_timeout: Duration,
    units: Vec<Unit<'a>>,
    phase: Phase,
}

/// Whether programs are started or ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Phase {
    Running,
    /// The programs are ended, the last one first.
    Stopping,
    /// All programs are ended at once, by SIGKILL.
    Killing,
}

/// A program with its state.
struct Unit<'a> {
    program: &'a Program,
    restarts: Restarts,
    state: State,
    has_failed: bool,
}

enum State {
    /// It starts as soon as its conditions hold.
    Waiting(Waiting),
    Running(Running),
    /// It is started again at this time.
    Delayed(Instant),
    Over,
}

struct Running {
    process: Process,
    ending: Ending,
}

/// The progress of the end of a process group.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Ending {
    /// Nothing was sent.
    None,
    /// SIGTERM was sent; SIGKILL follows at this time.
    Asked(Instant),
    /// SIGKILL was sent. The group is given up at this time.
    Killed(Instant),
}

impl<'a> Fleet<'a> {
    pub(super) fn new(
        programs: &'a [Program],
        socket: &'a Path,
        stop_timeout: Duration,
        guard: Guard,
        show: Show,
    ) -> Self {
        let unit = |program: &'a Program| Unit {
            program,
            restarts: Restarts::new(program.policy, program.max_restarts),
            state: State::Waiting(Waiting::new(clock::now())),
            has_failed: false,
        };
        Self {
            show,
            guard,
            socket,
            stop_timeout,
            units: programs.iter().map(unit).collect(),
            phase: Phase::Running,
        }
    }

    /// The pipes of the programs.
    pub(super) fn fds(&self) -> Vec<(BorrowedFd<'_>, For)> {
        let running = self.units.iter().filter_map(Unit::running);
        let open = running.filter(|it| it.process.is_open);
        open.map(|it| (it.process.as_fd(), For::Reading)).collect()
    }

    /// Whether all programs at these positions have ended for good.
    pub(super) fn is_over(&self, which: impl RangeBounds<usize>) -> bool {
        let units = self.units.iter().enumerate();
        let mut units = units.filter(|(at, _)| which.contains(at));
        units.all(|(_, it)| matches!(it.state, State::Over))
    }

    /// Whether the program at this position runs.
    pub(super) fn is_running(&self, at: usize) -> bool {
        self.units[at].running().is_some()
    }

    /// Whether the programs are ended.
    pub(super) fn is_ending(&self) -> bool {
        self.phase != Phase::Running
    }

    /// Whether a program has failed for good.
    pub(super) fn has_failed(&self) -> bool {
        self.units.iter().any(|it| it.has_failed)
    }

    /// Ends the programs, the last one first.
    pub(super) fn stop(&mut self) {
        if self.phase == Phase::Running {
            self.phase = Phase::Stopping;
            self.units.iter_mut().for_each(Unit::give_up);
        }
    }

    /// Ends all programs at once.
    pub(super) fn kill(&mut self) {
        self.stop();
        self.phase = Phase::Killing;
    }

    /// Reads logs, takes the ends of processes, and starts or ends the programs before the position `to` whose turn it
    /// is. Returns the time of the next call, if nothing happens before. `domain` is `None` while it is not known.
    pub(super) fn advance(&mut self, to: usize, domain: Option<&Domain>) -> Option<Instant> {
        self.read();
        self.take_ends();
        for at in 0..self.units.len() {
            self.end_group(at);
            if at < to {
                self.start_if_due(at, domain);
            }
        }
        match self.phase {
            Phase::Running => {}
            Phase::Stopping => self.stop_last(),
            Phase::Killing => (0..self.units.len()).for_each(|at| self.kill_unit(at)),
        }
        self.units.iter().take(to).filter_map(Unit::deadline).min()
    }

    fn read(&mut self) {
        for (at, unit) in self.units.iter_mut().enumerate() {
            if let Some(running) = unit.running_mut() {
                for line in running.process.read() {
                    self.show.program(at, Kind::Log, line);
                }
            }
        }
    }

    fn take_ends(&mut self) {
        for (pid, exit) in reap() {
            if let Err(error) = self.guard.replace(pid) {
                self.show.own(
                    Kind::Failed,
                    format!("cannot start the guard again: {error}"),
                );
            }
            let mut running = self.units.iter_mut().filter_map(Unit::running_mut);
            if let Some(running) = running.find(|it| it.process.pid() == pid) {
                running.process.exit = Some(exit);
            }
        }
    }

    /// Continues with the end of a program whose first process has ended, or that was asked to end.
    fn end_group(&mut self, at: usize) {
        let now = clock::now();
        let Some(running) = self.units[at].running_mut() else {
            return;
        };
        let is_gone = running.process.is_gone();
        match running.ending {
            _ if is_gone => self.ended(at, false),
            // It left processes behind.
            Ending::None if running.process.exit.is_some() => {
                running.process.signal(Signal::SIGTERM);
                running.ending = Ending::Asked(now.after(self.stop_timeout));
            }
            Ending::Asked(until) if until <= now => {
                let timeout = Span(self.stop_timeout);
                let text = format!("still runs {timeout} after SIGTERM: SIGKILL");
                self.show.program(at, Kind::Killing, text);
                self.units[at].has_failed |= self.phase == Phase::Stopping;
                self.kill_unit(at);
            }
            Ending::Killed(until) if until <= now => self.ended(at, true),
            Ending::None | Ending::Asked(_) | Ending::Killed(_) => {}
        }
    }

    /// The process group is gone, or the kernel does not remove it.
    fn ended(&mut self, at: usize, is_stuck: bool) {
        let unit = &mut self.units[at];
        let State::Running(mut running) = std::mem::replace(&mut unit.state, State::Over) else {
            return;
        };
        for line in running.process.last_lines() {
            self.show.program(at, Kind::Log, line);
        }
        let (process, now) = (&running.process, clock::now());
        let ran = now.since(process.since);
        let mut is_success = false;
        if let Some(exit) = process.exit {
            is_success = exit == Exit::Status(0);
            let text = format!("{exit} after {}", Span(ran));
            self.show.exited(at, process.pid().as_raw(), exit, text);
        }
        if is_stuck {
            unit.has_failed = true;
            let text = "the kernel does not end it, not even by SIGKILL";
            self.show.program(at, Kind::Failed, text);
        } else {
            self.guard.remove(process.pid());
        }
        if self.phase == Phase::Running && !is_stuck {
            self.decide(at, is_success, ran);
        }
    }

    /// Decides about the next start of a program that has ended or could not be started.
    fn decide(&mut self, at: usize, is_success: bool, ran: Duration) {
        let unit = &mut self.units[at];
        let text = match unit.restarts.decide(is_success, ran) {
            Next::Again(delay, left) => {
                unit.state = State::Delayed(clock::now().after(delay));
                let left = Counted::new(left.into(), "further restart");
                let text = format!("starts again in {} ({left})", Span(delay));
                return self.show.program(at, Kind::Restarting, text);
            }
            Next::Done => return,
            Next::Failed => "failed, and is not started again (`restart`)",
            Next::GaveUp => "is not started again: no restart is left (`max_restarts`)",
        };
        unit.has_failed = true;
        self.show.program(at, Kind::Failed, text);
    }

    fn start_if_due(&mut self, at: usize, domain: Option<&Domain>) {
        let (unit, now) = (&mut self.units[at], clock::now());
        if self.phase != Phase::Running {
            return;
        }
        if matches!(unit.state, State::Delayed(until) if until <= now) {
            unit.state = State::Waiting(Waiting::new(now));
        }
        let State::Waiting(waiting) = &mut unit.state else {
            return;
        };
        let unmet = unmet(unit.program, domain);
        if unmet.is_empty() {
            return self.start(at);
        }
        if let Some(waited) = waiting.report(now, domain.is_some()) {
            let text = format!("waits{waited}: {}", unmet.join("; "));
            self.show.program(at, Kind::Waiting, text);
        }
    }

    fn start(&mut self, at: usize) {
        let unit = &mut self.units[at];
        match Process::start(unit.program, self.socket) {
            Ok(process) => {
                self.guard.add(process.pid());
                let pid = process.pid().as_raw();
                unit.state = State::Running(Running {
                    process,
                    ending: Ending::None,
                });
                self.show
                    .started(at, pid, format!("started (process {pid})"));
            }
            Err(error) => {
                let text = not_started(unit.program, &error);
                self.show.program(at, Kind::NotStarted, text);
                unit.state = State::Over;
                self.decide(at, false, Duration::ZERO);
            }
        }
    }

    /// Asks the last program that runs to end.
    fn stop_last(&mut self) {
        let units = self.units.iter_mut().enumerate().rev();
        let mut running = units.filter_map(|(at, it)| Some((at, it.running_mut()?)));
        let Some((at, last)) = running.next() else {
            return;
        };
        if last.ending == Ending::None {
            last.process.signal(Signal::SIGTERM);
            // A stopped process takes no signal.
            last.process.signal(Signal::SIGCONT);
            last.ending = Ending::Asked(clock::now().after(self.stop_timeout));
            self.show.program(at, Kind::Stopping, "SIGTERM");
        }
    }

    fn kill_unit(&mut self, at: usize) {
        if let Some(running) = self.units[at].running_mut()
            && !matches!(running.ending, Ending::Killed(_))
        {
            running.process.signal(Signal::SIGKILL);
            running.ending = Ending::Killed(clock::now().after(KILL_TIMEOUT));
        }
    }
}

impl Unit<'_> {
    fn running(&self) -> Option<&Running> {
        match &self.state {
            State::Running(running) => Some(running),
            _ => None,
        }
    }

    fn running_mut(&mut self) -> Option<&mut Running> {
        match &mut self.state {
            State::Running(running) => Some(running),
            _ => None,
        }
    }

    /// A program that does not run is over.
    fn give_up(&mut self) {
        if self.running().is_none() {
            self.state = State::Over;
        }
    }

    /// When the state changes although nothing happens.
    fn deadline(&self) -> Option<Instant> {
        match &self.state {
            State::Waiting(waiting) => Some(waiting.report_at()),
            State::Delayed(until) => Some(*until),
            State::Running(running) => match running.ending {
                Ending::None => None,
                Ending::Asked(until) | Ending::Killed(until) => Some(until),
            },
            State::Over => None,
        }
    }
}

/// The conditions of a program that do not hold, with the counts that the domain has.
fn unmet(program: &Program, domain: Option<&Domain>) -> Vec<String> {
    let Some(domain) = domain else {
        let is_free = program.after.is_empty();
        return Vec::from_iter(
            (!is_free).then(|| "the state of the domain is not known yet".into()),
        );
    };
    let unmet = program.after.iter().filter(|it| !it.is_met(domain));
    unmet
        .map(|it| format!("{}{}", it.seen(domain), it.hint(domain)))
        .collect()
}

/// `cannot start /opt/lidar: No such file or directory (os error 2)`
fn not_started(program: &Program, error: &io::Error) -> String {
    format!("cannot start {}: {error}", program.command[0])
}
