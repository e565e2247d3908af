//! The cost of the machines in instructions. The number is the same on each run of one build, so a
//! change of a few instructions shows. This benchmark needs valgrind, and the runner in the version
//! of `gungraun` in Cargo.lock:
//!
//! ```sh
//! cargo install --locked gungraun-runner@VERSION
//! cargo bench --bench instructions
//! ```
//!
//! If one of these is missing, the program prints that and does nothing.
#![allow(missing_docs, reason = "what the macros of gungraun write has none")]

use std::{
    hint::black_box,
    process::{Command, Stdio},
};

use gungraun::{library_benchmark, library_benchmark_group};
use sm2_proto::{
    Contract, Datagram, LinkQos, Mismatch, Name, NameError, Violation,
    control::{ToManager, ToNode, decode_to_manager, decode_to_node},
    link::{Delivery, wire::Frame},
    match_contracts,
};

#[path = "../../../sm2-proto/tests/link_support/mod.rs"]
mod link_support;
#[path = "../../../sm2-proto/tests/ring_support/mod.rs"]
mod ring_support;
mod support;

use support::{
    Audience, NAMES, RingPair,
    contracts::{data, scan, subscriber},
};

// The result of a step is dropped outside of the measured part.

#[library_benchmark]
#[bench::steady(RingPair::steady())]
fn send(mut pair: Box<RingPair>) -> Box<RingPair> {
    pair.send();
    pair
}

#[library_benchmark]
#[bench::steady(with_message())]
fn take(mut pair: Box<RingPair>) -> (Delivery, Box<RingPair>) {
    (pair.take(), pair)
}

#[library_benchmark]
#[bench::steady(RingPair::steady())]
fn send_in_cell(mut pair: Box<RingPair>) -> Box<RingPair> {
    pair.send_in_cell();
    pair
}

#[library_benchmark]
#[bench::steady(with_cell())]
fn take_from_cell(mut pair: Box<RingPair>) -> (Delivery, Box<RingPair>) {
    (pair.take(), pair)
}

#[library_benchmark]
#[bench::steady(with_held())]
fn give_back(mut pair: Box<RingPair>) -> Box<RingPair> {
    pair.give_back();
    pair
}

#[library_benchmark]
#[bench::all(with_given_back())]
fn harvest(mut pair: Box<RingPair>) -> (usize, Box<RingPair>) {
    (pair.harvest(), pair)
}

#[library_benchmark]
#[bench::inline(support::data_inline().leak())]
#[bench::pooled(support::data_pooled().leak())]
fn decode_data(bytes: &[u8]) -> Result<Frame<'_>, Violation> {
    Frame::decode(black_box(&Datagram::new(bytes)))
}

#[library_benchmark]
#[bench::declare(support::declare().leak())]
fn decode_for_manager(bytes: &[u8]) -> Result<ToManager, Violation> {
    decode_to_manager(black_box(&Datagram::new(bytes)))
}

#[library_benchmark]
#[bench::link(support::link().leak())]
fn decode_for_node(bytes: &[u8]) -> Result<ToNode, Violation> {
    decode_to_node(black_box(&support::with_fd(bytes)))
}

#[library_benchmark]
#[bench::usual(NAMES[0])]
#[bench::longest(NAMES[1])]
fn parse_name(text: &str) -> Result<Name, NameError> {
    Name::new(black_box(text))
}

#[library_benchmark]
#[bench::same((scan(), subscriber("scan", Some(&data("Scan")))))]
fn contracts(pair: (Contract, Contract)) -> (Result<LinkQos, Mismatch>, (Contract, Contract)) {
    (match_contracts(&pair.0, &pair.1), pair)
}

#[library_benchmark]
#[bench::one(Audience::new(1))]
#[bench::hundred(Audience::new(100))]
#[bench::thousand(Audience::new(1_000))]
fn publisher(mut audience: Box<Audience>) -> Box<Audience> {
    audience.declare_publisher();
    audience
}

fn with_message() -> Box<RingPair> {
    let mut pair = RingPair::steady();
    pair.send();
    pair
}

fn with_cell() -> Box<RingPair> {
    let mut pair = RingPair::steady();
    pair.send_in_cell();
    pair
}

fn with_held() -> Box<RingPair> {
    let mut pair = with_message();
    pair.take();
    pair
}

fn with_given_back() -> Box<RingPair> {
    let mut pair = RingPair::steady();
    pair.carry_turn();
    pair
}

library_benchmark_group!(
    name = ring,
    benchmarks = [send, take, send_in_cell, take_from_cell, give_back, harvest]
);
library_benchmark_group!(
    name = decode,
    benchmarks = [decode_data, decode_for_manager, decode_for_node, parse_name]
);
library_benchmark_group!(name = matching, benchmarks = [contracts, publisher]);

/// The entry point that `gungraun` generates, which does not check its requirements.
mod counted {
    use super::{decode, matching, ring};

    pub(super) fn run() {
        main();
    }

    gungraun::main!(library_benchmark_groups = ring, decode, matching);
}

fn main() {
    // The runner starts this program again, once for each benchmark.
    if std::env::args().any(|it| it == "--gungraun-run") {
        return counted::run();
    }
    // `cargo test --benches` starts it as well, without this argument.
    if !std::env::args().any(|it| it == "--bench") {
        return println!("skipped: this is not a test");
    }
    for program in ["valgrind", "gungraun-runner"] {
        if !is_installed(program) {
            return println!(
                "skipped: {program} is missing; the head of {} says more",
                file!()
            );
        }
    }
    counted::run();
}

fn is_installed(program: &str) -> bool {
    let mut command = Command::new(program);
    command
        .arg("--version")
        .stdout(Stdio::null())
        .stderr(Stdio::null());
    command.status().is_ok()
}
