//! Wall time of a message, for the publisher and the subscriber together.
//!
//! Both are nodes of one thread, so no thread sleeps or waits for another core. The result is the time that
//! the library and the kernel need.
//!
//! `cargo bench --bench message [-- PART_OF_A_NAME]`

use std::time::Duration;

use criterion::{BenchmarkId, Criterion, Throughput, criterion_group, criterion_main};
use sm2_manager::{Background, Options};
use sm2_micro_bench::in_turns;
use sm2_node::{Node, Publisher, Sample, Subscriber};
use tempfile::TempDir;

const LANES: [(&str, bool); 2] = [("ring", true), ("socket", false)];
const SIZES: [usize; 3] = [64, 1 << 10, 64 << 10];
/// The number of messages that wait for a subscriber with the default depth.
const TURN: u64 = 8;
const MANY: u16 = 32;

/// A publisher and its subscriber, with the objects that keep them linked.
struct Pair {
    publisher: Publisher<[u8]>,
    subscriber: Subscriber<[u8]>,
    message: Vec<u8>,
    samples: Vec<Sample<[u8]>>,
    _nodes: [Node; 2],
    _manager: Background,
    _folder: TempDir,
}

impl Pair {
    fn linked(
        ring: bool,
        len_bytes: usize,
        depth: u16,
    ) -> Result<Self, Box<dyn std::error::Error>> {
        let folder = tempfile::tempdir()?;
        let socket = folder.path().join("domain.sock");
        let manager = Background::start(&socket, Options::default())?;
        let node = |name| {
            Node::builder(name)
                .socket(&socket)
                .ring_lane(ring)
                .connect()
        };
        let (talker, listener) = (node("talker")?, node("listener")?);
        let publisher = talker
            .publisher_builder::<[u8]>("topic")
            .depth(depth)
            .declare()?;
        let subscriber = listener
            .subscriber_builder::<[u8]>("topic")
            .depth(depth)
            .max_borrowed(depth)
            .declare()?;
        while publisher.links().iter().all(|it| !it.open) {
            listener.spin_some()?;
        }
        Ok(Self {
            publisher,
            subscriber,
            message: vec![1; len_bytes],
            samples: Vec::new(),
            _nodes: [talker, listener],
            _manager: manager,
            _folder: folder,
        })
    }

    fn publish(&mut self) {
        let published = self.publisher.publish(&self.message);
        published.expect("the link is open");
    }

    /// Takes and releases the next message, which must have arrived.
    fn take(&mut self) {
        let taken = self.subscriber.try_recv().expect("the link is open");
        drop(taken.expect("a message"));
    }

    /// Takes many messages: usually in one call, but a call reads a limited number of datagrams.
    fn take_many(&mut self) {
        while self.samples.len() < MANY.into() {
            let most = usize::from(MANY) - self.samples.len();
            let taken = self.subscriber.try_recv_many(&mut self.samples, most);
            assert_ne!(taken.expect("the link is open"), 0, "a message is missing");
        }
        self.samples.clear();
    }
}

fn pair(ring: bool, len_bytes: usize, depth: u16) -> Pair {
    Pair::linked(ring, len_bytes, depth).expect("a domain in a folder of its own")
}

fn one(criterion: &mut Criterion) {
    for (lane, ring) in LANES {
        let mut group = criterion.benchmark_group(lane);
        for len_bytes in SIZES {
            let pair = &mut pair(ring, len_bytes, TURN as u16);
            group.bench_function(BenchmarkId::new("publish", len_bytes), |bencher| {
                in_turns(bencher, TURN, pair, |_| (), Pair::publish, Pair::take);
            });
            group.bench_function(BenchmarkId::new("take", len_bytes), |bencher| {
                in_turns(bencher, TURN, pair, Pair::publish, Pair::take, |_| ());
            });
        }
    }
}

fn many(criterion: &mut Criterion) {
    for (lane, ring) in LANES {
        let mut group = criterion.benchmark_group(lane);
        group.throughput(Throughput::Elements(MANY.into()));
        for len_bytes in SIZES {
            let pair = &mut pair(ring, len_bytes, MANY);
            let publish = |pair: &mut Pair| (0..MANY).for_each(|_| pair.publish());
            let id = BenchmarkId::new(format!("take_{MANY}"), len_bytes);
            group.bench_function(id, |bencher| {
                in_turns(bencher, 1, pair, publish, Pair::take_many, |_| ());
            });
        }
    }
}

criterion_group! {
    name = message;
    config = Criterion::default()
        .warm_up_time(Duration::from_secs(1))
        .measurement_time(Duration::from_secs(2));
    targets = one, many
}
criterion_main!(message);
