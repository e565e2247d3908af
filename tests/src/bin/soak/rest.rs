//! A rest: nothing is sent, and all accounts and resources are compared.

use std::{
    thread,
    time::{Duration, Instant},
};

use sm2_tests::{TIMEOUT, census::Census};

use crate::{
    child::{Broken, Child, Holds},
    fleet::Witness,
    ledger::{self, End, GATEWAY_SERVICE},
    managers::Managers,
    report::Report,
    world::World,
};

/// How long accounts and resources may take to agree.
const SETTLING: Duration = Duration::from_secs(30);
/// Resources that have not changed for this long are the baseline of later comparisons.
const SETTLED: Duration = Duration::from_millis(1_500);
/// The time between two comparisons.
const PAUSE: Duration = Duration::from_millis(100);

/// The kinds of descriptors of memory for messages.
const MEMORY: [&str; 2] = ["memfd:sm2-segment", "memfd:sm2-message"];
/// The resources that a process may hold at a rest beyond its baseline.
#[derive(Clone, Copy)]
struct Slack {
    /// Memory for messages, in segments: publishers keep segments that they needed lately, for three sizes of
    /// messages.
    segments: u64,
    /// Rings: a link that was made in a shortage has none.
    rings: u64,
    /// Descriptors that wake sleeping threads: a node keeps a few of them.
    wakers: u64,
    /// Private memory: the allocator keeps what a burst needed.
    private_kib: u64,
}

const OF_A_NODE: Slack = Slack {
    segments: 8,
    rings: 4,
    wakers: 0,
    private_kib: 8 << 10,
};
/// A gateway is two nodes with many threads and tasks. It keeps messages of 1 MB for a while, and its publishers
/// have as many segments as the depth of their subscribers.
const OF_A_GATEWAY: Slack = Slack {
    segments: 64,
    rings: 8,
    wakers: 8,
    private_kib: 32 << 10,
};
const NONE: Slack = Slack {
    segments: 0,
    rings: 0,
    wakers: 0,
    private_kib: 0,
};

/// The resources of each process at the first rest.
#[derive(Default)]
pub(crate) struct Baseline(Vec<Holds>);

/// Lets the domains come to rest, compares, and sends again.
pub(crate) fn rest(
    world: &mut World,
    baseline: &mut Baseline,
    report: &mut Report,
) -> Result<(), Broken> {
    quiet(world, report)?;
    connected(world, report)?;
    balance(world, report)?;
    let World {
        managers,
        fleet,
        gateways,
        ..
    } = world;
    let witnesses = fleet.witnesses.iter().map(|it| &it.child);
    let managers = managers.iter().flat_map(|it| [&it.active, &it.standby]);
    let all: Vec<&Child> = witnesses.chain(managers).collect();
    if baseline.0.is_empty() {
        baseline.0 = settled(&all);
    } else {
        let pairs: Vec<_> = all.into_iter().zip(&baseline.0).collect();
        compare(&pairs, OF_A_NODE, report);
    }
    for gateway in &mut gateways.both {
        match &gateway.held {
            Some(held) => compare(&[(&gateway.child, held)], OF_A_GATEWAY, report),
            None => gateway.held = settled(&[&gateway.child]).pop(),
        }
    }
    world.rests += 1;
    report.rests += 1;
    for witness in &mut world.fleet.witnesses {
        witness.child.say("go");
    }
    Ok(())
}

/// Ends the victims, all stops and shortages, completes the take-overs, and waits until each message is
/// settled.
fn quiet(world: &mut World, report: &mut Report) -> Result<(), Broken> {
    world.fleet.kill_all(report);
    for managers in &mut world.managers {
        managers.active.relieve();
        managers.standby.relieve();
    }
    for gateway in &mut world.gateways.both {
        gateway.child.relieve();
    }
    for witness in &mut world.fleet.witnesses {
        witness.child.relieve();
        witness.child.say("rest");
    }
    // Looking at the witnesses would take their answers.
    while !world.managers.iter().all(Managers::are_settled) {
        for managers in &mut world.managers {
            managers.look(report)?;
        }
        thread::sleep(Duration::from_millis(1));
    }
    for witness in &mut world.fleet.witnesses {
        witness.child.answer("resting", report)?;
    }
    Ok(())
}

/// Waits until the gateways have linked all witnesses that have peers in the other domain only.
fn connected(world: &mut World, report: &mut Report) -> Result<(), Broken> {
    let start = Instant::now();
    loop {
        world.gateways.look(report)?;
        let mut missing = Vec::new();
        for witness in world.fleet.witnesses.iter_mut().filter(|it| it.is_remote()) {
            witness.child.say("links");
            if witness.child.answer("links", report)?.is_empty() {
                missing.push(witness.child.name.clone());
            }
        }
        if missing.is_empty() {
            return Ok(());
        }
        if start.elapsed() > TIMEOUT {
            report.error(&format!("no gateway has linked {missing:?}"));
            for gateway in &mut world.gateways.both {
                report.wrong(&gateway.child.process().stderr());
            }
            return Err(Broken);
        }
        thread::sleep(PAUSE);
    }
}

/// Compares the accounts of both ends of each link.
fn balance(world: &mut World, report: &mut Report) -> Result<(), Broken> {
    let start = Instant::now();
    loop {
        let mut ends = world.inspector.gateway_ends();
        for witness in &mut world.fleet.witnesses {
            witness.child.say("links");
        }
        for witness in &mut world.fleet.witnesses {
            let links = witness.child.answer("links", report)?;
            let words = links.split_whitespace();
            for text in words.filter(|it| *it != GATEWAY_SERVICE) {
                let Some(end) = End::parse(text) else {
                    report.error(&format!("{}: {text}", witness.child.name));
                    return Err(Broken);
                };
                ends.push((witness.child.name.clone(), end));
            }
        }
        let (missing, lines) = ledger::unaccounted(&ends);
        if missing == 0 {
            return Ok(());
        }
        if start.elapsed() > SETTLING {
            report.tally.unaccounted += missing;
            lines.iter().for_each(|line| report.wrong(line));
            return Ok(());
        }
        thread::sleep(PAUSE);
    }
}

/// The resources of processes after they have not changed for a while: a gateway that has just started makes
/// interfaces one after the other.
fn settled(all: &[&Child]) -> Vec<Holds> {
    let now = || -> Vec<Holds> { all.iter().map(|it| it.holds()).collect() };
    let start = Instant::now();
    let (mut held, mut since) = (now(), start);
    while since.elapsed() < SETTLED && start.elapsed() < SETTLING {
        thread::sleep(PAUSE);
        let new = now();
        if new
            .iter()
            .zip(&held)
            .any(|(new, old)| new.census != old.census)
        {
            since = Instant::now();
        }
        held = new;
    }
    held
}

/// Waits until each process holds no more than before, except for the slack.
fn compare(pairs: &[(&Child, &Holds)], slack: Slack, report: &mut Report) {
    let start = Instant::now();
    for (child, before) in pairs {
        let mut now = child.holds();
        let mut more = Excess::of(&now, before, slack);
        while !more.is_none() && start.elapsed() < SETTLING {
            thread::sleep(PAUSE);
            now = child.holds();
            more = Excess::of(&now, before, slack);
        }
        if !more.is_none() {
            report.wrong(&format!("{}: {before} before, {now} now", child.name));
        }
        report.fd_delta = report.fd_delta.max(more.descriptors);
        report.mapping_delta = report.mapping_delta.max(more.mappings);
        let grown = now.anonymous_kib.saturating_sub(before.anonymous_kib);
        report.rss_delta = report.rss_delta.max(grown);
    }
}

/// The resources that a process holds beyond others and the slack.
struct Excess {
    descriptors: u64,
    mappings: u64,
    private_kib: u64,
}

impl Excess {
    fn of(now: &Holds, before: &Holds, slack: Slack) -> Self {
        let private_kib = now.anonymous_kib.saturating_sub(before.anonymous_kib);
        let private_kib = private_kib.saturating_sub(slack.private_kib);
        let (now, before) = (&now.census, &before.census);
        let memory = |census: &Census| MEMORY.map(|kind| census.of_kind(kind)).iter().sum();
        let others = |census: &Census| census.descriptors() - memory(census);
        let segments = more(memory(now), memory(before)).saturating_sub(slack.segments);
        let others = more(others(now), others(before)).saturating_sub(slack.wakers);
        let mappings = more(now.mappings(), before.mappings()).saturating_sub(slack.segments);
        let rings = more(now.rings(), before.rings()).saturating_sub(slack.rings);
        Self {
            descriptors: others + segments,
            mappings: mappings + rings,
            private_kib,
        }
    }

    const fn is_none(&self) -> bool {
        self.descriptors + self.mappings + self.private_kib == 0
    }
}

const fn more(now: usize, before: usize) -> u64 {
    now.saturating_sub(before) as u64
}

/// Withdraws all interfaces. Each process must then hold what it held before it declared them.
pub(crate) fn close(world: &mut World, report: &mut Report) -> Result<(), Broken> {
    quiet(world, report)?;
    for witness in &mut world.fleet.witnesses {
        witness.child.say("close");
    }
    for witness in &mut world.fleet.witnesses {
        witness.child.answer("closed", report)?;
    }
    let witnesses = &world.fleet.witnesses;
    let before: Vec<Holds> = witnesses.iter().map(before_work).collect();
    let children = witnesses.iter().map(|it| &it.child);
    let pairs: Vec<_> = children.zip(&before).collect();
    compare(&pairs, NONE, report);
    Ok(())
}

/// The resources of a witness before its first declaration, and its file of counters. The private
/// memory is compared at the rests: a process allocates some with its first work.
fn before_work(witness: &Witness) -> Holds {
    Holds {
        census: witness.before.census.and_counters(1),
        anonymous_kib: u64::MAX,
    }
}
