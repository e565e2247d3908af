//! Single system calls that fail: every scenario reaches its goal after a transient error of any one call.
//!
//! A scenario runs once without an error, to count its calls, and then once for each call, each errno that the
//! call can have, and each number of the call: on the thread of the nodes, and on the thread of the Manager, or
//! on the threads of two gateways.
//! After each run this must hold:
//!
//! - every error that a program got has a type and a text, and its next try succeeded;
//! - no end accuses another one of a violation;
//! - each message that did not arrive is counted, at one end or the other;
//! - the process has the descriptors and mappings that it had before.
//!
//! The tests run a fixed sample: of the first calls, or of all calls with the feature `slow`. `SM2_FAULTS=all` runs
//! everything, and prints its progress: `SM2_FAULTS=all cargo test -p sm2-tests -- faults:: --nocapture`.
//! `SM2_FAULTS=CALL:NTH:ERRNO` runs one fault of each side.

mod accusations;
mod gateways;
mod scenarios;
mod topic;
mod world;

use sm2_test_support::ran_alone;
use std::{
    collections::BTreeMap,
    env,
    panic::{self, AssertUnwindSafe},
    process,
};

use sm2_io::fault::{Call, Fault};
use sm2_tests::census::Census;

use accusations::accusations;
use world::{Side, World};

/// Whether the sample is one of all calls. Otherwise it is one of the first call of each kind with each errno.
const ALL_CALLS: bool = cfg!(feature = "slow");

/// How many runs of one side are in the sample.
const SAMPLE: usize = if ALL_CALLS { 40 } else { 15 };

/// The same for gateways, whose runs take longer.
const SAMPLE_OF_GATEWAYS: usize = if ALL_CALLS { 40 } else { 3 };

/// A run of a scenario with a fault of one side. Returns how often each call was made.
fn run(
    scenario: fn(&mut World),
    side: Side,
    fault: Option<Fault>,
) -> Result<BTreeMap<Call, u64>, String> {
    let before = Census::of(process::id());
    let done = panic::catch_unwind(AssertUnwindSafe(|| {
        let mut world = World::start(side, fault);
        scenario(&mut world);
        world.end()
    }));
    let accused = accusations();
    let counts = done.map_err(|panic| {
        let text = panic.downcast_ref::<String>().map(String::as_str);
        text.or(panic.downcast_ref::<&str>().copied())
            .unwrap_or("a panic")
            .to_owned()
    })?;
    if !accused.is_empty() {
        return Err(format!("accusations: {accused:?}"));
    }
    let mut after = Census::of(process::id());
    let restored = sm2_tests::in_time(|| {
        after = Census::of(process::id());
        after == before
    });
    match restored {
        true => Ok(counts),
        false => Err(format!("left behind: {before} before, {after} after")),
    }
}

/// All single faults of the calls that were counted.
fn faults(counts: &BTreeMap<Call, u64>) -> Vec<Fault> {
    let mut all = Vec::new();
    for (&call, &count) in counts {
        for &errno in call.errnos() {
            all.extend((1..=count).map(|nth| Fault {
                call,
                nth,
                times: 1,
                errno,
            }));
        }
    }
    all
}

fn survives(name: &str, scenario: fn(&mut World)) {
    survives_at(&[Side::Nodes, Side::Manager], SAMPLE, name, scenario);
}

fn survives_at(sides: &[Side], sample: usize, name: &str, scenario: fn(&mut World)) {
    gateways::prepare();
    let wanted = env::var("SM2_FAULTS").ok();
    let all = wanted.as_deref() == Some("all");
    let only = wanted
        .filter(|_| !all)
        .map(|it| Fault::parse(&it).expect("all, or CALL:NTH:ERRNO"));
    for &side in sides {
        let counts = run(scenario, side, None).expect("the scenario works without a fault");
        let mut faults = only.map_or_else(|| faults(&counts), |it| vec![it]);
        assert!(only.is_some() || faults.len() > 10, "{side:?}: {counts:?}");
        if !(all || ALL_CALLS || only.is_some()) {
            faults.retain(|it| it.nth == 1);
        }
        let step = if all {
            1
        } else {
            faults.len().div_ceil(sample)
        };
        let mut failed = Vec::new();
        for (number, &fault) in faults.iter().enumerate().step_by(step) {
            if let Err(error) = run(scenario, side, Some(fault)) {
                failed.push(format!("{side:?} {fault:?}: {error}"));
            }
            if all && number % 50 == 0 {
                eprintln!("{name} {side:?}: {number} of {} faults", faults.len());
            }
        }
        assert!(
            failed.is_empty(),
            "{} faults of {name}:\n{}",
            failed.len(),
            failed.join("\n")
        );
    }
}

#[test]
fn publishing_through_rings_survives_each_fault() {
    if ran_alone(concat!(
        module_path!(),
        "::publishing_through_rings_survives_each_fault"
    )) {
        return;
    }
    survives("ring", scenarios::ring);
}

#[test]
fn publishing_through_sockets_survives_each_fault() {
    if ran_alone(concat!(
        module_path!(),
        "::publishing_through_sockets_survives_each_fault"
    )) {
        return;
    }
    survives("socket", scenarios::socket);
}

#[test]
fn publishing_sealed_files_survives_each_fault() {
    if ran_alone(concat!(
        module_path!(),
        "::publishing_sealed_files_survives_each_fault"
    )) {
        return;
    }
    survives("sealed", scenarios::sealed);
}

#[test]
fn a_latched_message_survives_each_fault() {
    if ran_alone(concat!(
        module_path!(),
        "::a_latched_message_survives_each_fault"
    )) {
        return;
    }
    survives("latched", scenarios::latched);
}

#[test]
fn a_call_survives_each_fault() {
    if ran_alone(concat!(module_path!(), "::a_call_survives_each_fault")) {
        return;
    }
    survives("call", scenarios::call);
}

#[test]
fn a_change_of_the_manager_survives_each_fault() {
    if ran_alone(concat!(
        module_path!(),
        "::a_change_of_the_manager_survives_each_fault"
    )) {
        return;
    }
    survives("change", scenarios::change);
}

#[test]
fn gateways_survive_each_fault() {
    if ran_alone(concat!(module_path!(), "::gateways_survive_each_fault")) {
        return;
    }
    survives_at(
        &[Side::Gateways],
        SAMPLE_OF_GATEWAYS,
        "gateways",
        gateways::gateways,
    );
}
