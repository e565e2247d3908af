//! The nodes of the run: witnesses, which live as long as the run, and victims.

use std::path::{Path, PathBuf};

use sm2_lossy_link::Side::{self, Far, Near};

use crate::{
    child::{Broken, Child, Holds},
    report::Report,
};

/// A process: its domain, name, role, topic, and further options in one text.
type Plan = (Side, &'static str, &'static str, &'static str, &'static str);

/// Messages of 10 MB, with few of them in memory at a time.
const BIG: &str = "--least 10000000 --most 10000000 --depth 2 --rate 30";
const FEW: &str = "--depth 2 --borrow 1";
/// A message that takes a third of a second on the bad link.
const IMAGE: &str = "--least 1000000 --most 1000000 --depth 2 --rate 10";
const LATCHED: &str = "--latched 4 --rate 50";
/// The topic of gateways that nobody subscribes to at a rest.
const LATE: &str = "away/site";
/// The messages come through the gateways.
const REMOTE: &str = "--remote true";
/// All requests need segments of the same size.
const OFFICE: &str = "--remote true --least 5000 --most 5000";

const WITNESSES: &[Plan] = &[
    (Near, "odometry", "publisher", "small", "--rate 1000"),
    (Near, "viewer", "subscriber", "small", ""),
    (Near, "logger", "subscriber", "small", "--reliable true"),
    (Near, "camera", "publisher", "big", BIG),
    (Near, "vision", "subscriber", "big", FEW),
    (Near, "map", "publisher", "latched", LATCHED),
    (
        Near,
        "planner",
        "late",
        "latched",
        "--latched 4 --reliable true",
    ),
    (Near, "adder", "server", "echo", ""),
    (Near, "asker", "client", "echo", ""),
    (Near, "visitors", "churn", "churn", ""),
    (Near, "pose", "publisher", "away/pose", "--rate 200"),
    (Near, "front", "publisher", "away/front", IMAGE),
    (Near, "site", "publisher", LATE, LATCHED),
    (Near, "station", "server", "away/echo", ""),
    (Near, "driver", "subscriber", "away/order", REMOTE),
    (Far, "operator", "publisher", "away/order", "--rate 50"),
    (Far, "screen", "subscriber", "away/pose", REMOTE),
    (Far, "window", "subscriber", "away/front", REMOTE),
    (Far, "office", "client", "away/echo", OFFICE),
];

const VICTIMS: &[Plan] = &[
    (Near, "victim/odometry", "publisher", "small", "--rate 1000"),
    (
        Near,
        "victim/viewer",
        "subscriber",
        "small",
        "--sealed true",
    ),
    (
        Near,
        "victim/logger",
        "subscriber",
        "small",
        "--reliable true",
    ),
    (Near, "victim/vision", "subscriber", "big", FEW),
    (Near, "victim/planner", "late", "latched", "--latched 4"),
    (Near, "victim/adder", "server", "echo", ""),
    (Near, "victim/asker", "client", "echo", ""),
    (Near, "victim/visitors", "churn", "churn", ""),
    (Near, "victim/pose", "publisher", "away/pose", "--rate 50"),
    (Far, "victim/screen", "subscriber", "away/pose", REMOTE),
    (
        Far,
        "victim/surveyor",
        "late",
        LATE,
        "--latched 4 --remote true",
    ),
    (Far, "victim/office", "client", "away/echo", OFFICE),
];

/// A witness, and what it held before it declared its interfaces.
pub(crate) struct Witness {
    pub(crate) child: Child,
    pub(crate) before: Holds,
}

impl Witness {
    /// Whether a gateway links it also at a rest.
    pub(crate) fn is_remote(&self) -> bool {
        let plan = WITNESSES.iter().find(|it| it.1 == self.child.name);
        plan.is_some_and(|it| it.3.starts_with("away/") && it.3 != LATE)
    }
}

/// All nodes.
pub(crate) struct Fleet {
    /// The sockets of the near and the far domain.
    sockets: [PathBuf; 2],
    pub(crate) witnesses: Vec<Witness>,
    pub(crate) victims: Vec<Child>,
}

impl Fleet {
    /// Starts the witnesses. There are no victims yet.
    pub(crate) fn start(sockets: [&Path; 2], report: &mut Report) -> Result<Self, Broken> {
        let mut fleet = Self {
            sockets: sockets.map(Path::to_owned),
            witnesses: Vec::new(),
            victims: Vec::new(),
        };
        for plan in WITNESSES {
            let mut child = fleet.start_one(plan, false);
            child.answer("connected", report)?;
            let before = child.holds();
            fleet.witnesses.push(Witness { child, before });
        }
        for witness in &mut fleet.witnesses {
            witness.child.say("go");
        }
        Ok(fleet)
    }

    pub(crate) fn start_victims(&mut self) {
        let victims = VICTIMS.iter().map(|plan| self.start_one(plan, true));
        self.victims = victims.collect();
    }

    /// Kills a victim. Another process takes its place and its name.
    pub(crate) fn kill(&mut self, index: usize, report: &mut Report) {
        report.kills += 1;
        let victim = &mut self.victims[index];
        victim.process().kill();
        victim.look(report);
        self.victims[index] = self.start_one(&VICTIMS[index], true);
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

    fn start_one(&self, plan: &Plan, go: bool) -> Child {
        let &(side, name, role, topic, more) = plan;
        let mut options = vec!["--name", name, "--topic", topic];
        options.extend(more.split_whitespace());
        if go {
            options.extend_from_slice(&["--go", "true"]);
        }
        let socket = &self.sockets[usize::from(side == Far)];
        Child::start(socket, role, name, &options)
    }
}
