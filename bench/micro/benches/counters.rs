//! Wall time of one change of a counters entry.
//!
//! `cargo bench --bench counters`

use std::{hint::black_box, time::Duration};

use criterion::{Criterion, criterion_group, criterion_main};
use sm2_io::CounterPage;
use sm2_proto::{Instant, InterfaceId, LinkId, link::Counters};

const LINK: LinkId = LinkId {
    epoch: 7,
    serial: 3,
};

fn update(criterion: &mut Criterion) {
    let mut group = criterion.benchmark_group("counters");
    let mut page = CounterPage::new().expect("a file in memory");
    let mut entry = page
        .allocate(InterfaceId(1), Some(LINK), Instant(0))
        .expect("room");
    let mut now = 1_000;
    group.bench_function("published", |bencher| {
        bencher.iter(|| {
            now += 1;
            entry.update().published(Instant(now), black_box(64));
        });
    });
    group.bench_function("taken", |bencher| {
        bencher.iter(|| {
            now += 1;
            let published = Instant(now - 1_000);
            entry.update().taken(Instant(now), published, black_box(64));
        });
    });
    let mut fates = Counters::default();
    group.bench_function("fates", |bencher| {
        bencher.iter(|| {
            fates.offered += 1;
            fates.delivered += 1;
            entry.update().fates(black_box(&fates));
        });
    });
    page.free(entry);
}

criterion_group! {
    name = counters;
    config = Criterion::default()
        .warm_up_time(Duration::from_secs(1))
        .measurement_time(Duration::from_secs(2));
    targets = update
}
criterion_main!(counters);
