//! The domain of an attack: its Managers and the processes that are measured.

use std::path::{Path, PathBuf};

use sm2_tests::{
    domain::TempDomain,
    eventually,
    process::{Process, this_program},
};

use crate::figures::Window;

/// All processes of a domain but the hostile ones.
pub(crate) struct World {
    pub(crate) domain: TempDomain,
    pub(crate) active: Process,
    pub(crate) standby: Process,
    /// Publishes what the subscriber and attackers subscribe to. It is only held.
    _publisher: Process,
    subscriber: Process,
    newcomer: Process,
}

impl World {
    /// Starts a domain, whose publisher and subscriber are linked.
    pub(crate) fn start() -> Self {
        let domain = TempDomain::new();
        let socket = domain.socket();
        let active = manager(&socket, false);
        active.stderr_says("serving");
        let publisher = start("publisher", &socket);
        let subscriber = start("subscriber", &socket);
        let newcomer = start("newcomer", &socket);
        let standby = manager(&socket, true);
        standby.stderr_says("standing by");
        for process in [&publisher, &subscriber, &newcomer] {
            assert_eq!(process.expect_line(), "ready");
        }
        Self {
            domain,
            active,
            standby,
            _publisher: publisher,
            subscriber,
            newcomer,
        }
    }

    pub(crate) fn socket(&self) -> PathBuf {
        self.domain.socket()
    }

    /// Begins a window.
    pub(crate) fn begin(&mut self) {
        self.subscriber.say("begin");
        self.newcomer.say("begin");
    }

    /// Ends the window.
    pub(crate) fn end(&mut self) -> Window {
        self.subscriber.say("end");
        self.newcomer.say("end");
        let subscriber = self.subscriber.expect_line();
        Window::parse(&subscriber, &self.newcomer.expect_line())
    }

    /// Kills the Manager that serves. Returns when its standby serves, and another one stands by.
    pub(crate) fn kill_manager(&mut self) {
        self.active.kill();
        self.standby.stderr_says("serving");
        let next = manager(&self.domain.socket(), true);
        self.active = std::mem::replace(&mut self.standby, next);
        eventually("a standby", || {
            self.standby.stderr().contains("standing by")
        });
    }
}

/// Starts this program in a role.
pub(crate) fn start(role: &str, socket: &Path) -> Process {
    let mut command = this_program(role);
    command.arg("--socket").arg(socket);
    Process::start(command)
}

/// Starts a Manager.
pub(crate) fn manager(socket: &Path, standby: bool) -> Process {
    let mut command = this_program("manager");
    command.arg("--socket").arg(socket);
    if standby {
        command.args(["--standby", "true"]);
    }
    Process::start(command)
}
