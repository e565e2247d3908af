use super::*;

fn percentiles(nanos: impl IntoIterator<Item = u64>) -> Percentiles {
    let mut latencies = Latencies::default();
    nanos.into_iter().for_each(|nanos| latencies.record(nanos));
    latencies.total()
}

#[test]
fn percentiles_are_values_that_occurred() {
    let thousand = percentiles((1..=1_000).rev().map(|micros| micros * 1_000));
    let expected = Percentiles {
        p50: 500.0,
        p99: 990.0,
        max: 1_000.0,
    };
    assert_eq!(thousand, expected);

    let one = percentiles([1_234]);
    assert_eq!((one.p50, one.p99, one.max), (1.3, 1.3, 1.3));
    assert_eq!(percentiles([]), Percentiles::default());
    assert_eq!(percentiles([1_000, 9_000]).p50, 1.0);
}

#[test]
fn a_second_starts_where_the_last_one_ended() {
    let mut latencies = Latencies::default();
    latencies.record(1_000);
    assert_eq!(latencies.take_second().max, 1.0);
    assert_eq!(latencies.take_second(), Percentiles::default());
    latencies.record(5_000);
    assert_eq!(latencies.take_second().p50, 5.0);
    assert_eq!(latencies.total().p50, 1.0);
}

#[test]
fn a_rate_counts_the_gaps() {
    let (start, end) = (Instant(5), Instant(2_000_000_005));
    assert_eq!(rate(61, start, end), 30.0);
    assert_eq!(rate(1, start, start), 0.0);
    assert_eq!(rate(0, start, end), 0.0);
    assert_eq!(rate(2, start, start), 0.0);
}
