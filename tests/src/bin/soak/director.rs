//! The run itself.

use std::{
    fs,
    sync::atomic::{AtomicBool, Ordering},
    thread,
    time::{Duration, Instant},
};

use sm2_tests::{domain::TempDomain, random::Random};

use crate::{
    child::Broken,
    disturbance::Disturbance,
    report::Report,
    rest::{self, Baseline},
    world::World,
};

/// The time between two rests: a sixth of the run, within these limits.
const REST_LEAST: Duration = Duration::from_secs(5);
const REST_MOST: Duration = Duration::from_secs(60);
const TURN: Duration = Duration::from_millis(2);

/// Runs for this long, or until `stop` is true.
pub(crate) fn run(length: Duration, stop: &AtomicBool) -> Report {
    let mut report = Report::new();
    let domains = [TempDomain::new(), TempDomain::new()];
    let stays = drive(&domains, length, stop, &mut report);
    if stays.is_err() {
        report.wrong("the run ended early");
    }
    let files = domains.each_ref().map(TempDomain::files).concat();
    let children = children();
    report.residue = (files.len() + children) as u64;
    if stays.is_ok() && report.residue > 0 {
        report.wrong(&format!("left: {files:?} and {children} processes"));
    }
    report
}

fn drive(
    domains: &[TempDomain; 2],
    length: Duration,
    stop: &AtomicBool,
    report: &mut Report,
) -> Result<(), Broken> {
    let start = Instant::now();
    let mut disturbance = Disturbance::new(Random::seeded());
    let mut world = World::start(domains, report)?;
    let mut baseline = Baseline::default();
    let every = (length / 6).clamp(REST_LEAST, REST_MOST);
    let over = || start.elapsed() >= length || stop.load(Ordering::Relaxed);
    while !over() {
        world.fleet.start_victims();
        let rest_at = Instant::now() + every;
        while Instant::now() < rest_at && !over() {
            disturbance.act(&mut world, report);
            world.look(report)?;
            report.progress();
            thread::sleep(TURN);
        }
        rest::rest(&mut world, &mut baseline, report)?;
    }
    if stop.load(Ordering::Relaxed) {
        println!("stopped by a signal");
    }
    rest::close(&mut world, report)?;
    world.end(report);
    Ok(())
}

/// The number of child processes that still exist.
fn children() -> usize {
    let threads = fs::read_dir("/proc/self/task").into_iter().flatten();
    let lists = threads.flatten().map(|it| it.path().join("children"));
    let lists = lists.filter_map(|path| fs::read_to_string(path).ok());
    lists.map(|list| list.split_whitespace().count()).sum()
}
