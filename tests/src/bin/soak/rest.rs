//! A rest: nothing is sent, and all accounts and resources are compared.

use std::{
    thread,
    time::{Duration, Instant},
};

use sm2_tests::census::Census;

use crate::{
    child::{Broken, Child, Holds},
    fleet::{Fleet, Witness},
    ledger::{self, End},
    managers::Managers,
    report::Report,
};

/// How long accounts and resources may take to agree.
const SETTLING: Duration = Duration::from_secs(30);
/// The time between two comparisons.
const PAUSE: Duration = Duration::from_millis(100);

/// The kinds of descriptors of memory for messages.
const MEMORY: [&str; 2] = ["memfd:sm2-segment", "memfd:sm2-message"];
/// At a rest, a process may hold this much more memory for messages, in segments, than at the first
/// rest: publishers keep segments that they needed lately, for three sizes of messages.
const SEGMENTS_MORE: u64 = 8;

/// The resources of each process at the first rest.
#[derive(Default)]
pub(crate) struct Baseline(Vec<(String, Holds)>);

/// Lets the domain come to rest, compares, and sends again.
pub(crate) fn rest(
    managers: &mut Managers,
    fleet: &mut Fleet,
    baseline: &mut Baseline,
    report: &mut Report,
) -> Result<(), Broken> {
    quiet(managers, fleet, report)?;
    balance(fleet, report)?;
    let mut all: Vec<&mut Child> = fleet.witnesses.iter_mut().map(|it| &mut it.child).collect();
    all.extend([&mut managers.active, &mut managers.standby]);
    if baseline.0.is_empty() {
        let holds = all.iter().map(|it| (it.name.clone(), it.holds()));
        baseline.0 = holds.collect();
    } else {
        let before = baseline.0.iter().map(|(_, before)| before);
        let pairs: Vec<_> = all.iter().map(|it| &**it).zip(before).collect();
        compare(&pairs, SEGMENTS_MORE, report);
    }
    report.rests += 1;
    for witness in &mut fleet.witnesses {
        witness.child.say("go");
    }
    Ok(())
}

/// Ends the victims, completes the take-over, continues all processes, and waits until each message
/// is settled.
fn quiet(managers: &mut Managers, fleet: &mut Fleet, report: &mut Report) -> Result<(), Broken> {
    fleet.kill_all(report);
    managers.active.resume();
    managers.standby.resume();
    for witness in &mut fleet.witnesses {
        witness.child.resume();
        witness.child.say("rest");
    }
    while !managers.are_settled() {
        managers.look(report)?;
        thread::sleep(Duration::from_millis(1));
    }
    for witness in &mut fleet.witnesses {
        witness.child.answer("resting", report)?;
    }
    Ok(())
}

/// Compares the accounts of both ends of each link.
fn balance(fleet: &mut Fleet, report: &mut Report) -> Result<(), Broken> {
    let start = Instant::now();
    loop {
        let mut ends = Vec::new();
        for witness in &mut fleet.witnesses {
            witness.child.say("links");
        }
        for witness in &mut fleet.witnesses {
            let links = witness.child.answer("links", report)?;
            for text in links.split_whitespace() {
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

/// Waits until each process holds no more than before, except for so many segments.
fn compare(pairs: &[(&Child, &Holds)], segments_more: u64, report: &mut Report) {
    let start = Instant::now();
    for (child, before) in pairs {
        let mut now = child.holds();
        let mut more = Excess::of(&now.census, &before.census, segments_more);
        while !more.is_none() && start.elapsed() < SETTLING {
            thread::sleep(PAUSE);
            now = child.holds();
            more = Excess::of(&now.census, &before.census, segments_more);
        }
        if !more.is_none() {
            let (was, is) = (&before.census, &now.census);
            report.wrong(&format!("{}: {was} before, {is} now", child.name));
        }
        report.fd_delta = report.fd_delta.max(more.descriptors);
        report.mapping_delta = report.mapping_delta.max(more.mappings);
        let grown = now.anonymous_kib.saturating_sub(before.anonymous_kib);
        report.rss_delta = report.rss_delta.max(grown);
    }
}

/// The resources that a process holds beyond a census.
struct Excess {
    descriptors: u64,
    mappings: u64,
}

impl Excess {
    fn of(now: &Census, before: &Census, segments_more: u64) -> Self {
        let memory = |census: &Census| MEMORY.map(|kind| census.of_kind(kind)).iter().sum();
        let others = |census: &Census| census.descriptors() - memory(census);
        let segments = more(memory(now), memory(before)).saturating_sub(segments_more);
        let mappings = more(now.mappings(), before.mappings()).saturating_sub(segments_more);
        Self {
            descriptors: more(others(now), others(before)) + segments,
            mappings: mappings + more(now.rings(), before.rings()),
        }
    }

    const fn is_none(&self) -> bool {
        self.descriptors + self.mappings == 0
    }
}

const fn more(now: usize, before: usize) -> u64 {
    now.saturating_sub(before) as u64
}

/// Withdraws all interfaces. Each process must then hold what it held before it declared them.
pub(crate) fn close(
    managers: &mut Managers,
    fleet: &mut Fleet,
    report: &mut Report,
) -> Result<(), Broken> {
    quiet(managers, fleet, report)?;
    for witness in &mut fleet.witnesses {
        witness.child.say("close");
    }
    for witness in &mut fleet.witnesses {
        witness.child.answer("closed", report)?;
    }
    let before: Vec<Holds> = fleet.witnesses.iter().map(before_work).collect();
    let children = fleet.witnesses.iter().map(|it| &it.child);
    let pairs: Vec<_> = children.zip(&before).collect();
    compare(&pairs, 0, report);
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
