//! The nodes of the run: witnesses, which live as long as the run, and victims.

use std::path::{Path, PathBuf};

use crate::{
    child::{Broken, Child, Holds},
    report::Report,
};

/// The options of messages of 10 MB, with few of them in memory at a time.
const BIG: [&str; 6] = ["--least", "10000000", "--most", "10000000", "--depth", "2"];

/// A process: name, role, topic, further options.
type Plan = (
    &'static str,
    &'static str,
    &'static str,
    &'static [&'static str],
);

const WITNESSES: &[Plan] = &[
    ("odometry", "publisher", "small", &["--rate", "1000"]),
    ("viewer", "subscriber", "small", &[]),
    ("logger", "subscriber", "small", &["--reliable", "true"]),
    ("camera", "publisher", "big", &["--rate", "30"]),
    (
        "vision",
        "subscriber",
        "big",
        &["--depth", "2", "--borrow", "1"],
    ),
    (
        "map",
        "publisher",
        "latched",
        &["--latched", "4", "--rate", "50"],
    ),
    (
        "planner",
        "late",
        "latched",
        &["--latched", "4", "--reliable", "true"],
    ),
    ("adder", "server", "echo", &[]),
    ("asker", "client", "echo", &[]),
    ("visitors", "churn", "churn", &[]),
];

const VICTIMS: &[Plan] = &[
    ("victim/odometry", "publisher", "small", &["--rate", "1000"]),
    (
        "victim/viewer",
        "subscriber",
        "small",
        &["--sealed", "true"],
    ),
    (
        "victim/logger",
        "subscriber",
        "small",
        &["--reliable", "true"],
    ),
    (
        "victim/vision",
        "subscriber",
        "big",
        &["--depth", "2", "--borrow", "1"],
    ),
    ("victim/planner", "late", "latched", &["--latched", "4"]),
    ("victim/adder", "server", "echo", &[]),
    ("victim/asker", "client", "echo", &[]),
    ("victim/visitors", "churn", "churn", &[]),
];

/// A witness, and what it held before it declared its interfaces.
pub(crate) struct Witness {
    pub(crate) child: Child,
    pub(crate) before: Holds,
}

/// All nodes.
pub(crate) struct Fleet {
    socket: PathBuf,
    pub(crate) witnesses: Vec<Witness>,
    pub(crate) victims: Vec<Child>,
}

impl Fleet {
    /// Starts the witnesses. There are no victims yet.
    pub(crate) fn start(socket: &Path, report: &mut Report) -> Result<Self, Broken> {
        let mut witnesses = Vec::new();
        for plan in WITNESSES {
            let mut child = start(socket, plan, false);
            child.answer("connected", report)?;
            let before = child.holds();
            witnesses.push(Witness { child, before });
        }
        for witness in &mut witnesses {
            witness.child.say("go");
        }
        Ok(Self {
            socket: socket.to_owned(),
            witnesses,
            victims: Vec::new(),
        })
    }

    pub(crate) fn start_victims(&mut self) {
        let victims = VICTIMS.iter().map(|plan| start(&self.socket, plan, true));
        self.victims = victims.collect();
    }

    /// Kills a victim. Another process takes its place and its name.
    pub(crate) fn kill(&mut self, index: usize, report: &mut Report) {
        report.kills += 1;
        let victim = &mut self.victims[index];
        victim.process().kill();
        victim.look(report);
        *victim = start(&self.socket, &VICTIMS[index], true);
    }

    /// Kills all victims.
    pub(crate) fn kill_all(&mut self, report: &mut Report) {
        for mut victim in self.victims.drain(..) {
            report.kills += 1;
            victim.process().kill();
            victim.look(report);
        }
    }

    /// Reads the lines of all nodes. No node may have ended by itself.
    pub(crate) fn look(&mut self, report: &mut Report) -> Result<(), Broken> {
        let witnesses = self.witnesses.iter_mut().map(|it| &mut it.child);
        for child in witnesses.chain(&mut self.victims) {
            child.look(report);
            child.must_live(report)?;
        }
        Ok(())
    }
}

fn start(socket: &Path, plan: &Plan, go: bool) -> Child {
    let &(name, role, topic, more) = plan;
    let mut options = vec!["--name", name, "--topic", topic];
    options.extend_from_slice(more);
    if role == "publisher" && topic == "big" {
        options.extend_from_slice(&BIG);
    }
    if go {
        options.extend_from_slice(&["--go", "true"]);
    }
    Child::start(socket, role, name, &options)
}
