//! A Manager dies in various ways, and another one takes over. The nodes of the domain notice
//! nothing.

// Shows CLI-SURVIVE (test, full).

use std::{
    collections::BTreeSet,
    sync::{Mutex, MutexGuard, PoisonError},
    thread,
    time::{Duration, Instant},
};

use sm2_node::{Node, NodeBuilder};
use sm2_proto::{LinkId, domain::Domain};
use sm2_tests::{
    actor::number,
    domain::{ManagerProcess, TempDomain},
    process::{Process, actor},
    random::Random,
};

/// The nodes that exchange small messages.
const NODES: usize = if cfg!(feature = "slow") { 50 } else { 10 };
const NODES_PER_PROCESS: usize = 5;
/// The distances of the nodes that a node subscribes to: two, so there are twice as many links as nodes.
const HEARS: [&str; 2] = ["1", "8"];
/// How often the serving Manager is killed.
const KILLS: usize = if cfg!(feature = "slow") { 50 } else { 5 };
/// How often both Managers are killed, and for how long the domain is without any.
const GAPS: usize = if cfg!(feature = "slow") { 3 } else { 1 };
const GAP: Duration = Duration::from_millis(if cfg!(feature = "slow") { 2_000 } else { 300 });
/// How often a Manager replaces another one.
const HAND_OVERS: usize = if cfg!(feature = "slow") { 10 } else { 3 };
/// Messages of 10 MB in each second.
const BIG_RATE: usize = if cfg!(feature = "slow") { 30 } else { 5 };

/// The deadline of the Managers for claims, in seconds: a machine that is busy with other work delays some of the
/// nodes for longer than the default.
const PATIENCE: [&str; 2] = ["--recovery-ms", "60000"];

/// One load at a time: two of them starve nodes on two cores.
static LOADED: Mutex<()> = Mutex::new(());

/// The nodes under load: some with small messages, and two whose link carries messages of 10 MB.
struct Load {
    processes: Vec<Process>,
    _alone: MutexGuard<'static, ()>,
}

impl Load {
    fn start(domain: &TempDomain) -> Self {
        let alone = LOADED.lock().unwrap_or_else(PoisonError::into_inner);
        let flow = |prefix: &str, options: &[(&str, usize)], hears: &str| {
            let mut command = actor("flow");
            command.arg("--socket").arg(domain.socket());
            command.args(["--prefix", prefix, "--hears", hears]);
            for (name, value) in options {
                command.args([name.to_string(), value.to_string()]);
            }
            Process::start(command)
        };
        let mut all: Vec<Process> = (0..NODES / NODES_PER_PROCESS)
            .map(|process| {
                let options = [
                    ("--first", process * NODES_PER_PROCESS),
                    ("--count", NODES_PER_PROCESS),
                    ("--total", NODES),
                    ("--rate", 20),
                    ("--size", 100),
                ];
                flow("flow", &options, &HEARS.join(","))
            })
            .collect();
        let two = |index, rate, hearers| {
            [
                ("--first", index),
                ("--count", 1),
                ("--total", 2),
                ("--rate", rate),
                ("--size", 10_000_000),
                ("--hearers", hearers),
            ]
        };
        all.push(flow("big", &two(0, BIG_RATE, 1), ""));
        all.push(flow("big", &two(1, 0, 0), "1"));
        let mut load = Self {
            processes: all,
            _alone: alone,
        };
        load.step("linked", "go");
        load.step("flowing", "");
        load
    }

    /// Waits for a line of each process, and then sends a line to each.
    fn step(&mut self, heard: &str, say: &str) {
        for process in &self.processes {
            assert_eq!(process.expect_line(), heard);
        }
        self.processes
            .iter_mut()
            .for_each(|process| process.say(say));
    }

    /// Ends the flow. Every message must have arrived once, in order, on the first link between its
    /// two nodes.
    fn stop(&mut self) {
        self.processes
            .iter_mut()
            .for_each(|process| process.say("stop"));
        let reports: Vec<String> = self.processes.iter().map(Process::expect_line).collect();
        let sum = |key: &str, reports: &[String]| -> u64 {
            reports.iter().map(|report| number(report, key)).sum()
        };
        let (big, small) = (&reports[reports.len() - 2..], &reports[..reports.len() - 2]);
        assert_eq!(sum("received", small), 2 * sum("published", small));
        assert_eq!(sum("links", small), 2 * NODES as u64);
        assert_eq!(sum("received", big), sum("published", big));
        assert_eq!(sum("links", big), 1);
        println!(
            "{} small messages and {} of 10 MB, none lost, none doubled",
            sum("received", small),
            sum("received", big)
        );
    }
}

/// The parts of a domain without standbys and observer, by names that do not depend on the Manager.
#[derive(Debug, PartialEq, Eq)]
struct State {
    nodes: BTreeSet<String>,
    interfaces: BTreeSet<String>,
    links: BTreeSet<(LinkId, String)>,
}

const OBSERVER: &str = "observer";

impl State {
    fn of(domain: &Domain) -> Self {
        let counts = |name: &str| !name.starts_with("sm2/standby") && name != OBSERVER;
        let mut state = Self {
            nodes: BTreeSet::new(),
            interfaces: BTreeSet::new(),
            links: BTreeSet::new(),
        };
        let name = |node| domain.node(node).map_or("?", |it| it.name.as_str());
        let nodes = domain.nodes().map(|it| it.name.as_str().to_owned());
        state.nodes = nodes.filter(|name| counts(name)).collect();
        for it in domain.interfaces() {
            let owner = name(it.entity.node);
            if counts(owner) {
                let number = it.entity.interface.0;
                let text = format!("{owner} {number} {:?}", it.contract);
                state.interfaces.insert(text);
            }
        }
        for it in domain.links() {
            let ends = [it.offering, it.demanding];
            let ends = ends.map(|end| format!("{} {}", name(end.node), end.interface.0));
            state.links.insert((it.link, ends.join(" -> ")));
        }
        state
    }

    /// Waits until the domain has this state.
    #[track_caller]
    fn comes_back(&self, observer: &Node) {
        let mut last = None;
        let back = sm2_tests::in_time(|| {
            last = observer.snapshot().ok().map(|it| Self::of(&it));
            last.as_ref() == Some(self)
        });
        let Some(last) = last.filter(|_| !back) else {
            return;
        };
        let gone: Vec<_> = self.links.difference(&last.links).collect();
        let new: Vec<_> = last.links.difference(&self.links).collect();
        let missing: Vec<_> = self.nodes.difference(&last.nodes).collect();
        panic!("links gone: {gone:?}\nlinks new: {new:?}\nnodes missing: {missing:?}");
    }
}

fn observer(domain: &TempDomain) -> Node {
    let builder: NodeBuilder = Node::builder(OBSERVER).socket(domain.socket());
    // A declaration may have to wait until a Manager is started.
    let builder = builder.manager_timeout(sm2_tests::TIMEOUT);
    builder.connect().expect("a session")
}

/// Declares an interface. Returns how long it took until it was granted.
fn declaration(observer: &Node, round: usize) -> Duration {
    let start = Instant::now();
    let publisher = observer.publisher::<[u8]>(&format!("probe/{round}"));
    publisher.expect("granted");
    start.elapsed()
}

/// Starts a Manager that takes over.
fn start(domain: &TempDomain, way: &str) -> ManagerProcess {
    domain.manager_start(&[&PATIENCE[..], &[way, "true"]].concat())
}

/// The Managers of a domain: one serves, and one stands by.
struct Pair {
    active: ManagerProcess,
    standby: ManagerProcess,
}

impl Pair {
    fn start(domain: &TempDomain) -> Self {
        let active = domain.manager_with(&PATIENCE);
        let standby = start(domain, "--standby");
        standby.log_says("standing by");
        Self { active, standby }
    }

    /// Kills the serving Manager. The standby has no standby itself until `refill`.
    fn kill(&mut self) {
        self.active.kill();
    }

    /// Waits until the standby serves, and starts another standby.
    fn refill(&mut self, domain: &TempDomain) {
        self.standby.log_says("serving");
        let standby = start(domain, "--standby");
        standby.log_says("standing by");
        self.active = std::mem::replace(&mut self.standby, standby);
    }
}

/// Prints the median and the longest time.
fn print_times(what: &str, mut times: Vec<Duration>) {
    times.sort_unstable();
    let p50 = times[times.len() / 2];
    println!(
        "{what}: p50 {p50:?}, max {:?}, n {}",
        times[times.len() - 1],
        times.len()
    );
}

//= SM2-RES-001, SM2-RES-002, SM2-RES-004, SM2-RES-007, SM2-NOD-003 sys
//= SM2-TRN-007, SM2-SES-008 sys
#[test]
fn kills_of_the_manager_under_load_are_not_noticed() {
    let domain = TempDomain::new();
    let mut managers = Pair::start(&domain);
    let mut load = Load::start(&domain);
    let observer = observer(&domain);
    let before = State::of(&observer.snapshot().expect("a snapshot"));
    assert_eq!(before.nodes.len(), NODES + 2);
    assert_eq!(before.links.len(), 2 * NODES + 1);
    let mut random = Random::seeded();
    let mut times = Vec::new();
    for round in 0..KILLS {
        // Some kills hit a resumption.
        thread::sleep(Duration::from_millis(random.next() % 150));
        managers.kill();
        times.push(declaration(&observer, round));
        managers.refill(&domain);
        if round % 5 == 4 {
            before.comes_back(&observer);
        }
    }
    before.comes_back(&observer);
    load.stop();
    print_times("a declaration, from the kill on", times);
}

//= SM2-RES-001, SM2-RES-004 sys
#[test]
fn both_managers_killed_and_one_started_later() {
    let domain = TempDomain::new();
    let mut managers = Pair::start(&domain);
    let mut load = Load::start(&domain);
    let observer = observer(&domain);
    let before = State::of(&observer.snapshot().expect("a snapshot"));
    let mut times = Vec::new();
    for round in 0..GAPS {
        managers.standby.kill();
        managers.active.kill();
        // Messages flow, and the nodes try to reconnect.
        thread::sleep(GAP);
        managers = Pair::start(&domain);
        times.push(declaration(&observer, round));
        before.comes_back(&observer);
    }
    load.stop();
    print_times("a declaration, from the start on", times);
}

//= SM2-RES-009, SM2-NOD-003 sys
#[test]
fn a_hand_over_is_not_noticed() {
    let domain = TempDomain::new();
    let mut active = domain.manager_with(&PATIENCE);
    let mut load = Load::start(&domain);
    let observer = observer(&domain);
    let before = State::of(&observer.snapshot().expect("a snapshot"));
    for round in 0..HAND_OVERS {
        let next = start(&domain, "--replace");
        declaration(&observer, round);
        next.log_says("serving");
        let exit = active.wait();
        assert_eq!(
            exit,
            sm2_tests::process::Exit::Status(0),
            "{}",
            active.log()
        );
        active = next;
        before.comes_back(&observer);
    }
    load.stop();
    assert!(!active.has_ended(), "{}", active.log());
}
