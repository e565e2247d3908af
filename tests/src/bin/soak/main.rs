//! `cargo run --release -p sm2-tests --bin soak -- --seconds N [--json]`: two domains under load, whose
//! processes are killed and stopped at random for N seconds.
//!
//! | process | load | killed |
//! | --- | --- | --- |
//! | witness | its payloads, counters, descriptors, mappings and memory are checked | no |
//! | victim | the same load; a new one takes its place at once | yes |
//! | Manager and its standby, for each domain | the domain | yes |
//! | gateway of each domain | the topics and the service `away/**`, over a bad link | in turns |
//!
//! All of them are stopped (SIGSTOP) and continued at random. Now and then one of them gets no further
//! descriptors, or no further addresses for mappings, for a while. From time to time the domains come to
//! rest: the victims end, and the witnesses stop sending. Both ends of each link must then agree
//! about every message, and each process must hold what it held at the first rest. Between two rests, only
//! one of the gateways is killed; the other one must hold what it held at the rest before. At the end each
//! witness withdraws its interfaces, and must hold what it held before it declared them.
//!
//! The bad link needs root, `ip`, `tc` and `nft`; without them it is a relay on the loopback interface.
//!
//! `SM2_TEST_SEED` sets the seed of the random choices, which is printed. Ctrl-C ends the run in
//! order, with a report. Exit status: 0 if nothing was wrong, 1 if something was, 2 for wrong usage.

mod child;
mod director;
mod disturbance;
mod fleet;
mod gateways;
mod inspector;
mod ledger;
mod managers;
mod message;
mod report;
mod rest;
mod role;
mod shortage;
mod tally;
mod world;

use std::{
    process::ExitCode,
    sync::{Arc, atomic::AtomicBool},
    time::Duration,
};

use signal_hook::consts::{SIGINT, SIGTERM};
use sm2_tests::options::Options;

const USAGE: &str = "usage: soak --seconds N [--json]";

fn main() -> ExitCode {
    let mut arguments = std::env::args().skip(1).peekable();
    // The processes of the run are started from this program, with a role.
    if let Some(role) = arguments.next_if(|it| !it.starts_with('-')) {
        let options = Options::parse(arguments);
        println!("{}", child::STARTED);
        return match role.as_str() {
            "manager" => sm2_tests::manager::run(&options),
            "gateway" => sm2_tests::gateway::run(&options),
            role => role::run(role, &options),
        };
    }
    let (mut seconds, mut json) = (None, false);
    while let Some(argument) = arguments.next() {
        match argument.as_str() {
            "--seconds" => seconds = arguments.next().and_then(|it| it.parse().ok()),
            "--json" => json = true,
            _ => {
                seconds = None;
                break;
            }
        }
    }
    let Some(seconds @ 1..) = seconds else {
        eprintln!("{USAGE}");
        return ExitCode::from(2);
    };
    let stop = Arc::new(AtomicBool::new(false));
    for signal in [SIGINT, SIGTERM] {
        signal_hook::flag::register(signal, Arc::clone(&stop)).expect("a signal handler");
    }
    let report = director::run(Duration::from_secs(seconds), &stop);
    report.print(json);
    if report.is_clean() {
        ExitCode::SUCCESS
    } else {
        ExitCode::FAILURE
    }
}
