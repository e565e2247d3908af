//! The cost of the machines in wall time: no sockets, no shared memory, no other process.
//!
//! `cargo bench --bench machine [-- PART_OF_A_NAME]`

use std::{hint::black_box, time::Duration};

use criterion::{BatchSize, BenchmarkId, Criterion, Throughput, criterion_group, criterion_main};
use sm2_micro_bench::in_turns;
use sm2_proto::{
    Datagram, Name,
    control::{decode_to_manager, decode_to_node},
    link::wire::Frame,
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

/// As many steps as a ring has room for.
const TURN: u64 = RingPair::DEPTH as u64;

fn ring(criterion: &mut Criterion) {
    let mut group = criterion.benchmark_group("ring");
    let pair = &mut *RingPair::steady();
    group.bench_function("send", |bencher| {
        let after = |pair: &mut RingPair| {
            pair.take();
            pair.give_back();
            pair.harvest();
        };
        in_turns(bencher, TURN, pair, |_| (), RingPair::send, after);
    });
    group.bench_function("take", |bencher| {
        let after = |pair: &mut RingPair| {
            pair.give_back();
            pair.harvest();
        };
        in_turns(bencher, TURN, pair, RingPair::send, RingPair::take, after);
    });
    let cells = &mut *RingPair::steady();
    group.bench_function("send_in_cell", |bencher| {
        let after = |pair: &mut RingPair| drop(pair.take());
        in_turns(bencher, TURN, cells, |_| (), RingPair::send_in_cell, after);
    });
    group.bench_function("take_from_cell", |bencher| {
        let send = RingPair::send_in_cell;
        in_turns(bencher, TURN, cells, send, RingPair::take, |_| ());
    });
    group.bench_function("give_back", |bencher| {
        let before = |pair: &mut RingPair| {
            pair.send();
            pair.take();
        };
        let after = |pair: &mut RingPair| {
            pair.harvest();
        };
        in_turns(bencher, TURN, pair, before, RingPair::give_back, after);
    });
    group.throughput(Throughput::Elements(TURN));
    group.bench_function(BenchmarkId::new("harvest", TURN), |bencher| {
        let harvest = |pair: &mut RingPair| assert_eq!(pair.harvest(), TURN as usize);
        in_turns(bencher, 1, pair, RingPair::carry_turn, harvest, |_| ());
    });
}

fn decode(criterion: &mut Criterion) {
    let mut group = criterion.benchmark_group("decode");
    for (name, bytes) in [
        ("data_inline", support::data_inline()),
        ("data_pooled", support::data_pooled()),
    ] {
        let datagram = Datagram::new(&bytes);
        assert!(Frame::decode(&datagram).is_ok());
        group.bench_function(name, |bencher| {
            bencher.iter(|| Frame::decode(black_box(&datagram)).is_ok());
        });
    }
    let declare = support::declare();
    let datagram = Datagram::new(&declare);
    assert!(decode_to_manager(&datagram).is_ok());
    group.bench_function("declare", |bencher| {
        bencher.iter(|| decode_to_manager(black_box(&datagram)));
    });
    let link = support::link();
    let datagram = support::with_fd(&link);
    assert!(decode_to_node(&datagram).is_ok());
    group.bench_function("link", |bencher| {
        bencher.iter(|| decode_to_node(black_box(&datagram)));
    });
    for text in NAMES {
        assert!(Name::new(text).is_ok());
        group.bench_function(BenchmarkId::new("name", text.len()), |bencher| {
            bencher.iter(|| Name::new(black_box(text)));
        });
    }
}

fn matching(criterion: &mut Criterion) {
    let mut group = criterion.benchmark_group("match");
    let (one, other) = (scan(), subscriber("scan", Some(&data("Scan"))));
    assert!(match_contracts(&one, &other).is_ok());
    group.bench_function("contracts", |bencher| {
        bencher.iter(|| match_contracts(black_box(&one), black_box(&other)).is_ok());
    });
    for subscribers in [1, 100, 1_000] {
        let audience = Audience::new(subscribers);
        let id = BenchmarkId::new("publisher", subscribers);
        group.bench_function(id, |bencher| {
            bencher.iter_batched_ref(
                || audience.clone(),
                |audience| audience.declare_publisher(),
                BatchSize::LargeInput,
            );
        });
    }
}

criterion_group! {
    name = machine;
    config = Criterion::default()
        .warm_up_time(Duration::from_secs(1))
        .measurement_time(Duration::from_secs(2));
    targets = ring, decode, matching
}
criterion_main!(machine);
