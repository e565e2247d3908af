//! The Manager that serves, and the one that stands by.

use std::{
    mem,
    path::{Path, PathBuf},
    thread,
    time::{Duration, Instant},
};

use nix::sys::signal::Signal;
use sm2_tests::TIMEOUT;

use crate::{
    child::{Broken, Child},
    report::Report,
};

/// The Managers of a domain.
pub(crate) struct Managers {
    socket: PathBuf,
    pub(crate) active: Child,
    pub(crate) standby: Child,
    /// The change that is going on, and its beginning.
    changing: Option<(Change, Instant)>,
}

/// A change of the Managers.
#[derive(Clone, Copy)]
enum Change {
    /// A new standby starts.
    Standby,
    /// The standby takes over.
    TakeOver,
}

/// After this time without a take-over, a Manager that was to hand over serves on.
const HAND_OVER: Duration = Duration::from_secs(15);

impl Managers {
    pub(crate) fn start(socket: &Path, report: &mut Report) -> Result<Self, Broken> {
        let active = Child::start(socket, "manager", "a Manager", &[]);
        wait_for(&active, "serving", report)?;
        Ok(Self {
            socket: socket.to_owned(),
            active,
            standby: standby(socket),
            changing: now(Change::Standby),
        })
    }

    /// Whether one Manager serves and the other one stands by.
    pub(crate) const fn are_settled(&self) -> bool {
        self.changing.is_none()
    }

    /// Kills the Manager that serves. Its standby takes over.
    pub(crate) fn kill_active(&mut self, report: &mut Report) {
        report.kills += 1;
        self.active.process().kill();
        self.changing = now(Change::TakeOver);
    }

    /// Makes the Manager that serves hand over to its standby.
    pub(crate) fn hand_over(&mut self) {
        self.active.relieve();
        self.standby.relieve();
        self.active.process().signal(Signal::SIGUSR2);
        self.changing = now(Change::TakeOver);
    }

    /// Kills the standby, and starts another one.
    pub(crate) fn kill_standby(&mut self, report: &mut Report) {
        report.kills += 1;
        self.standby = standby(&self.socket);
        self.changing = now(Change::Standby);
    }

    /// Looks whether a change is complete.
    pub(crate) fn look(&mut self, report: &mut Report) -> Result<(), Broken> {
        self.active.look(report);
        self.standby.look(report);
        let Some((change, since)) = self.changing else {
            self.active.must_live(report)?;
            return self.standby.must_live(report);
        };
        match change {
            Change::TakeOver if self.standby.log_has("serving") => {
                report.takeovers += 1;
                let next = standby(&self.socket);
                self.active = mem::replace(&mut self.standby, next);
                self.changing = now(Change::Standby);
            }
            Change::TakeOver
                if since.elapsed() > HAND_OVER && !self.active.process().has_ended() =>
            {
                self.changing = None;
            }
            Change::Standby if self.standby.log_has("standing by") => self.changing = None,
            Change::TakeOver | Change::Standby if since.elapsed() > TIMEOUT => {
                let log = self.standby.process().stderr();
                report.error(&format!("no Manager serves, or none stands by: {log}"));
                return Err(Broken);
            }
            Change::TakeOver | Change::Standby => {}
        }
        Ok(())
    }

    /// Ends both in order.
    pub(crate) fn end(self, report: &mut Report) {
        for mut manager in [self.standby, self.active] {
            manager.end(report);
        }
    }
}

#[allow(clippy::unnecessary_wraps, reason = "the value of a field")]
fn now(change: Change) -> Option<(Change, Instant)> {
    Some((change, Instant::now()))
}

fn standby(socket: &Path) -> Child {
    Child::start(socket, "manager", "a Manager", &["--standby", "true"])
}

fn wait_for(manager: &Child, text: &str, report: &mut Report) -> Result<(), Broken> {
    let start = Instant::now();
    while !manager.log_has(text) {
        if start.elapsed() > TIMEOUT {
            report.error(&format!("{} does not say {text:?}", manager.name));
            return Err(Broken);
        }
        thread::sleep(Duration::from_millis(5));
    }
    Ok(())
}
