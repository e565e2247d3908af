//! The attacks.

use std::{
    thread,
    time::{Duration, Instant},
};

use nix::sys::signal::Signal;
use sm2_tests::process::{Process, this_program};

use crate::{remote::Remote, world::World};

/// How often a Manager is killed.
const KILLS: Duration = Duration::from_millis(500);

/// An attack, as the table names it.
pub(crate) struct Attack {
    pub(crate) name: &'static str,
    means: Means,
}

/// The means of an attack.
enum Means {
    /// This many processes in a role of `hostile`, which then go on or, if they are stopped, are stopped when
    /// they are linked.
    Processes(u32, &'static str, Stopped),
    /// The Manager is killed again and again; a standby takes over.
    KilledManagers,
    /// The Manager is stopped.
    StoppedManager,
    /// A gateway has a peer behind a slow link, and may be stopped.
    SlowPeer(Stopped),
}

#[derive(Clone, Copy, PartialEq, Eq)]
enum Stopped {
    No,
    Yes,
}

const fn by(name: &'static str, count: u32, role: &'static str) -> Attack {
    Attack {
        name,
        means: Means::Processes(count, role, Stopped::No),
    }
}

const fn stopped(name: &'static str, role: &'static str) -> Attack {
    Attack {
        name,
        means: Means::Processes(1, role, Stopped::Yes),
    }
}

pub(crate) const ATTACKS: &[Attack] = &[
    by(
        "a publisher that breaks the protocol, linked again and again",
        1,
        "violator",
    ),
    by("connections with 253 descriptors each", 1, "descriptors"),
    by("connections that come and go", 1, "connections"),
    by("a process with all its sessions, silent", 1, "sessions"),
    by("two subscribers that never release a message", 2, "hoarder"),
    by("sealed files of 900 MB with holes", 1, "sparse-files"),
    by("sparse segments of 1 TiB", 1, "sparse-segments"),
    by("DECLARE and WITHDRAW with 1,000 matches", 1, "churn"),
    by(
        "50 processes that declare and withdraw, with 80 matches each",
        50,
        "busy",
    ),
    by("a node that asks and does not read", 1, "deaf"),
    stopped("a subscriber is stopped (SIGSTOP)", "subscriber"),
    stopped("a reliable subscriber is stopped", "reliable"),
    stopped("another publisher of the topic is stopped", "publisher"),
    Attack {
        name: "the Manager is stopped",
        means: Means::StoppedManager,
    },
    Attack {
        name: "the Manager is killed twice a second",
        means: Means::KilledManagers,
    },
    Attack {
        name: "a gateway's peer has 1 Mbit/s for 16 Mbit/s",
        means: Means::SlowPeer(Stopped::No),
    },
    Attack {
        name: "the gateway is stopped",
        means: Means::SlowPeer(Stopped::Yes),
    },
];

/// An attack that goes on.
pub(crate) struct Running {
    processes: Vec<Process>,
    remote: Option<Remote>,
    kills_managers: bool,
    stops_manager: bool,
}

impl Attack {
    /// Begins the attack. Its processes are linked, or refused, when this returns.
    pub(crate) fn begin(&self, world: &mut World) -> Running {
        let mut running = Running {
            processes: Vec::new(),
            remote: None,
            kills_managers: false,
            stops_manager: false,
        };
        match self.means {
            Means::Processes(count, role, stops) => {
                for number in 0..count {
                    let mut process = attacker(world, role, number);
                    assert_eq!(process.expect_line(), "ready");
                    if stops == Stopped::Yes {
                        process.stop();
                    }
                    running.processes.push(process);
                }
            }
            Means::KilledManagers => running.kills_managers = true,
            Means::StoppedManager => {
                world.active.stop();
                running.stops_manager = true;
            }
            Means::SlowPeer(stops) => {
                let mut remote = Remote::start(&world.socket());
                if stops == Stopped::Yes {
                    remote.gateway().stop();
                }
                running.remote = Some(remote);
            }
        }
        running
    }
}

impl Running {
    /// Lets the attack go on for this long.
    pub(crate) fn go_on(&mut self, world: &mut World, length: Duration) {
        let end = Instant::now() + length;
        while let Some(rest) = end.checked_duration_since(Instant::now()) {
            thread::sleep(rest.min(KILLS));
            if self.kills_managers {
                world.kill_manager();
            }
        }
    }

    /// Kills the attackers.
    pub(crate) fn end(self, world: &mut World) {
        drop((self.processes, self.remote));
        if self.stops_manager {
            world.active.signal(Signal::SIGCONT);
        }
    }
}

fn attacker(world: &World, role: &str, number: u32) -> Process {
    let mut command = this_program("attack");
    command.arg("--socket").arg(world.socket());
    command.args(["--role", role, "--number", &number.to_string()]);
    Process::start(command)
}
