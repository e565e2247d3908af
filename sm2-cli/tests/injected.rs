//! The shipped programs while the kernel fails one of their system calls: `strace` injects the error from outside.
//!
//! A scenario runs once without an error, to count the calls of one of its programs, the victim. Then it runs once
//! for each call, each errno that the call can have, and each number of the call. `strace` counts the calls of each
//! thread from 1, so the error may hit several threads, once each. After each run this must hold:
//!
//! - the victim did its work, or ended with status 1 and a line that says why, and its next try succeeded;
//! - no program panicked, hung, or accused another one of a violation;
//! - each message arrived undamaged, or one end says that it is missing;
//! - every process has ended, and the files in the folder of the domain are those of a run without an error.
//!
//! Two scenarios run the first fault of each call. With the feature `slow`, all scenarios run a larger sample.
//! `SM2_INJECT=all` runs everything, and prints its progress:
//! `SM2_INJECT=all cargo test -p sm2-cli --features slow --test injected -- --nocapture`.
//! `SM2_INJECT=CALL:NTH:ERRNO` runs one fault, such as `mmap:30:ENOMEM`.
//!
//! `SM2_BINARIES=target/release` takes `sm2`, `sm2-manager` and `sm2-gateway` from that folder; without it, all
//! programs are the command `sm2` that Cargo has built for the tests.

#[path = "injected/programs.rs"]
mod programs;
#[path = "injected/scenarios.rs"]
mod scenarios;
#[path = "injected/strace.rs"]
mod strace;
#[path = "injected/world.rs"]
mod world;

use std::{
    env,
    panic::{self, AssertUnwindSafe},
};

use sm2_test_support::skip_without;
use strace::{Fault, Victim};

/// How many faults of a scenario are in the sample of slow tests.
const SAMPLE: usize = 8;

/// Runs a scenario, which returns the files that it leaves behind, with the faults of its victim. `always` are faults
/// that are in every sample, because they were found to do harm.
fn survives(name: &str, scenario: fn(&Victim) -> Vec<String>, always: &[&str]) {
    if let Err(reason) = strace::is_available() {
        return skip_without("strace", reason);
    }
    let wanted = env::var("SM2_INJECT").ok();
    let all = wanted.as_deref() == Some("all");
    let only = wanted.filter(|_| !all);
    let only = only.map(|it| Fault::parse(&it).expect("all, or CALL:NTH:ERRNO"));
    let (victim, log) = Victim::counted();
    let files = scenario(&victim);
    let counted = log.faults();
    assert!(counted.len() > 20, "{name}: {counted:?}");
    let always = always.iter().map(|it| Fault::parse(it).expect("a fault"));
    let faults: Vec<Fault> = match only {
        Some(fault) => vec![fault],
        None if all => counted,
        None if cfg!(not(feature = "slow")) => strace::first_of_each(counted),
        None => {
            let step = counted.len().div_ceil(SAMPLE);
            counted.into_iter().step_by(step).chain(always).collect()
        }
    };
    let mut failed = Vec::new();
    for (number, fault) in faults.iter().enumerate() {
        let victim = Victim::injected(fault);
        let done = panic::catch_unwind(AssertUnwindSafe(|| scenario(&victim)));
        match done {
            Ok(left) if left == files => {}
            Ok(left) => failed.push(format!("{fault}: left {left:?}, not {files:?}")),
            Err(panic) => {
                let text = panic.downcast_ref::<String>().map(String::as_str);
                let text = text.or(panic.downcast_ref::<&str>().copied());
                failed.push(format!("{fault}: {}", text.unwrap_or("a panic")));
            }
        }
        if all && number % 50 == 0 {
            eprintln!("{name}: {number} of {} faults", faults.len());
        }
    }
    let count = failed.len();
    assert!(
        failed.is_empty(),
        "{count} faults of {name}:\n{}",
        failed.join("\n")
    );
}

#[test]
fn a_publisher_survives_each_fault() {
    survives("publish", scenarios::publish, &[]);
}

#[test]
#[cfg_attr(not(feature = "slow"), ignore = "slow")]
fn a_subscriber_survives_each_fault() {
    survives("subscribe", scenarios::subscribe, &[]);
}

#[test]
#[cfg_attr(not(feature = "slow"), ignore = "slow")]
fn a_subscriber_that_writes_files_survives_each_fault() {
    survives("files", scenarios::files, &[]);
}

#[test]
#[cfg_attr(not(feature = "slow"), ignore = "slow")]
fn a_call_survives_each_fault() {
    survives("call", scenarios::call, &[]);
}

#[test]
fn a_manager_survives_each_fault() {
    survives("manager", scenarios::manager, &[]);
}

#[test]
#[cfg_attr(not(feature = "slow"), ignore = "slow")]
fn a_manager_that_takes_over_survives_each_fault() {
    survives(
        "take over",
        scenarios::take_over,
        &["clone3:1:EAGAIN", "flock:2:ENOLCK"],
    );
}

#[test]
#[cfg_attr(not(feature = "slow"), ignore = "slow")]
fn a_manager_that_hands_over_survives_each_fault() {
    survives("hand over", scenarios::hand_over, &[]);
}

#[test]
#[cfg_attr(not(feature = "slow"), ignore = "slow")]
fn a_gateway_survives_each_fault() {
    survives(
        "gateway",
        scenarios::gateway,
        &["clone3:1:EAGAIN", "clone3:2:EAGAIN", "clone3:3:EAGAIN"],
    );
}
