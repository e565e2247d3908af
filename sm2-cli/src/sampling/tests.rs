use super::*;

fn entry(delays: &[u64]) -> Entry {
    let mut entry = Entry {
        messages: delays.len() as u64,
        ..Entry::default()
    };
    for (message, delay) in (1..).zip(delays) {
        entry.recent_ns[sm2_proto::counters::recent_index(message)] = *delay;
    }
    entry
}

#[test]
fn the_median_is_one_of_the_recent_delays() {
    assert_eq!(median_ns(&entry(&[])), None);
    assert_eq!(median_ns(&entry(&[7])), Some(7));
    assert_eq!(median_ns(&entry(&[9, 1, 5])), Some(5));
    assert_eq!(median_ns(&entry(&[4, 3, 2, 1])), Some(2));
    // Only the last 32 messages count.
    let many: Vec<u64> = (0..100).collect();
    assert_eq!(median_ns(&entry(&many)), Some(83));
}

#[test]
fn milliseconds_are_rounded_to_microseconds() {
    assert_eq!(millis(1_234_567), 1.235);
    assert_eq!(millis(0), 0.0);
    assert_eq!(hundredths(1.005_1), 1.01);
}
