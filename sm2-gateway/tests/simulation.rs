//! Simulates whole gateways in one thread, under a virtual clock, over a network that loses,
//! duplicates, delays and cuts off datagrams. Checks that denied subjects never get through, that
//! no message arrives twice, that every call ends once, and that after a quiet time everything
//! reachable is visible.
//!
//! `SM2_SIM_SEEDS=1000` runs more seeds, and `SM2_SIM_SEED=17` runs one. A seed leads to the same
//! events at the same times in every run. Only the bytes of datagrams differ, and the length of a
//! handshake by a few bytes, because TLS and QUIC take keys, connection ids and grease from the
//! system.

// Shows GW-NOLOOP (test, full), bound: sampled: 24 seeds for each of four arrangements of up to four gateways; virtual
// time, loss, reordering, duplication, partitions, crashes.

mod domain;
mod ledger;
mod link;
mod network;
mod node;
mod ops;
mod queue;
mod quiet;
mod random;
mod rules;
mod script;
mod trace;

use std::{
    collections::BTreeMap,
    panic::{AssertUnwindSafe, catch_unwind, resume_unwind},
};

use script::{Arrangement, Simulation};

/// How long random events occur.
const SCRIPT_MS: u64 = 15_000;
/// How long the network stays good before the final checks: longer than the idle timeouts and the
/// longest waits.
const QUIET_MS: u64 = 25_000;
/// The number of worlds of each arrangement.
const SEEDS: u64 = 24;
/// The number of worlds that run twice.
const TWICE: u64 = if cfg!(feature = "slow") { 4 } else { 1 };

/// The result of one seed, compared between runs.
#[derive(Debug, Default, PartialEq, Eq)]
struct Outcome {
    digest: u64,
    events: u64,
    delivered: u64,
    answered: BTreeMap<u64, u64>,
}

fn run(arrangement: Arrangement, seed: u64) -> Outcome {
    let mut simulation = Simulation::new(arrangement, seed);
    let ran = catch_unwind(AssertUnwindSafe(|| {
        simulation.run(SCRIPT_MS);
        simulation.heal();
        simulation.run(QUIET_MS);
        simulation.check_quiet();
    }));
    let ledger = &simulation.world.ledger;
    if let Err(panic) = ran {
        eprintln!(
            "{}{arrangement:?} {seed} failed at {} ms: \
             SM2_SIM_SEED={seed} cargo test --workspace --test gateway simulation",
            ledger.trace.tail(),
            simulation.now.0 / network::MS,
        );
        resume_unwind(panic);
    }
    Outcome {
        digest: ledger.trace.digest(),
        events: ledger.trace.count,
        delivered: ledger.delivered,
        answered: ledger.answered.clone(),
    }
}

fn number(variable: &str) -> Option<u64> {
    let text = std::env::var(variable).ok()?;
    Some(
        text.parse()
            .unwrap_or_else(|_| panic!("{variable}: {text} is not a number")),
    )
}

/// Runs all worlds, or a few. The large ones take longer, and more happens in them.
fn seeds(arrangement: Arrangement, few: u64) {
    let all = if cfg!(feature = "slow") { SEEDS } else { few };
    let seeds = match number("SM2_SIM_SEED") {
        Some(seed) => seed..seed + 1,
        None => 0..number("SM2_SIM_SEEDS").unwrap_or(all),
    };
    let (mut delivered, mut ok) = (0, 0);
    let is_all = seeds.start == 0 && seeds.end >= all;
    for seed in seeds {
        let outcome = run(arrangement, seed);
        delivered += outcome.delivered;
        ok += outcome.answered.get(&0).copied().unwrap_or(0);
    }
    println!("{arrangement:?}: {delivered} messages, {ok} calls");
    // A simulation with few messages that arrive would find no errors.
    let is_enough = delivered * SEEDS > 100 * all && ok * SEEDS > 50 * all;
    assert!(!is_all || is_enough, "{delivered} {ok}");
}

#[test]
fn two_gateways() {
    seeds(Arrangement::Pair, 6);
}

#[test]
fn two_gateways_without_descriptors_for_all() {
    seeds(Arrangement::ShortPair, 4);
}

#[test]
fn a_chain_of_three() {
    seeds(Arrangement::Chain, 3);
}

#[test]
fn three_that_all_know_each_other() {
    seeds(Arrangement::Triangle, 2);
}

#[test]
fn a_ring_of_four() {
    seeds(Arrangement::Ring, 1);
}

#[test]
fn a_seed_leads_to_the_same_each_time() {
    for seed in 0..TWICE {
        let first = run(Arrangement::Triangle, seed);
        assert_eq!(run(Arrangement::Triangle, seed), first, "seed {seed}");
    }
}
