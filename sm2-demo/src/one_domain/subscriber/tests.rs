use super::*;

const LEN_BYTES: usize = 100;

fn message(number: u64) -> Vec<u8> {
    let mut message = vec![0; LEN_BYTES];
    pattern::fill(number, &mut message);
    message
}

#[test]
fn each_message_is_newer_than_the_last_one() {
    let mut counter = ReceptionCounter::new(LEN_BYTES as u64);
    for number in [3, 4, 9] {
        assert_eq!(counter.check(&message(number)), Ok(()), "{number}");
    }
    // The same memory once more, and an old one.
    for number in [9, 9, 8] {
        assert_eq!(counter.check(&message(number)), Err(0), "{number}");
    }
    assert_eq!(counter.check(&message(9)), Ok(()), "newer than the old one");
}

#[test]
fn a_message_of_another_length_differs_where_the_shorter_one_ends() {
    let mut counter = ReceptionCounter::new(LEN_BYTES as u64);
    let mut long = message(1);
    long.push(0);
    assert_eq!(counter.check(&long), Err(LEN_BYTES as u64));
    assert_eq!(counter.check(&message(1)[..70]), Err(70));
    assert_eq!(counter.check(&[]), Err(0));
    let mut changed = message(1);
    changed[42] ^= 1;
    assert_eq!(counter.check(&changed), Err(42));
    assert_eq!(counter.check(&message(1)), Ok(()));
}

#[test]
fn the_total_has_the_rate_of_the_whole_run() {
    let mut counter = ReceptionCounter::new(LEN_BYTES as u64);
    counter.figures.messages = 5;
    counter.figures.lost = 2;
    counter.last = counter.first.after(Duration::from_secs(2));
    counter.latencies.record(7_000);
    let total = counter.total();
    assert_eq!((total.messages, total.lost, total.hz), (5, 2, 2.0));
    assert_eq!(total.latency_us.max, 7.0);
}
