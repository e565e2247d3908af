use sm2_manager::Background;
use sm2_test_support::SOON;

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

/// Messages as they arrive: one with a wrong byte, and some that the subscriber had no room for.
#[test]
fn what_arrives_is_counted() {
    let folder = tempfile::tempdir().unwrap();
    let socket = folder.path().join("demo.sock");
    let _manager = Background::start(&socket, sm2_manager::Options::default()).unwrap();
    let node = Node::builder("node").socket(&socket).connect().unwrap();
    let publisher = node.publisher_builder::<[u8]>(TOPIC).depth(2).declare();
    let subscriber = node.subscriber_builder::<[u8]>(TOPIC).depth(2).declare();
    let (publisher, subscriber) = (publisher.unwrap(), subscriber.unwrap());
    publisher.wait_for_subscribers_timeout(1, SOON).unwrap();
    let mut counter = ReceptionCounter::new(LEN_BYTES as u64);
    let begin = counter.first;
    let send = |number, changed: Option<usize>| {
        let mut bytes = message(number);
        if let Some(at) = changed {
            bytes[at] ^= 1;
        }
        publisher.publish(&bytes).unwrap();
    };
    let mut take = || {
        let sample = subscriber.recv_timeout(SOON).unwrap().expect("a message");
        counter.take(&sample);
        counter.figures
    };
    send(0, None);
    let first = take();
    assert_eq!((first.messages, first.lost, first.damaged), (1, 0, 0));
    send(1, Some(50));
    take();
    send(2, Some(60));
    let third = take();
    assert_eq!((third.messages, third.lost, third.damaged), (3, 0, 2));
    let spot = third.first_damage.map(|it| (it.message, it.offset));
    assert_eq!(spot, Some((2, 50)), "the first one");
    // Of these, two wait at most.
    for number in 3..10 {
        send(number, None);
    }
    let fourth = take();
    assert!(fourth.lost >= 5, "{fourth:?}");
    let fifth = take();
    assert_eq!((fifth.messages, fifth.damaged), (5, 2));
    let total = counter.total();
    assert_eq!(
        (total.messages, total.lost, total.damaged),
        (5, fifth.lost, 2)
    );
    assert!(counter.first > begin && counter.last > counter.first);
    assert!(total.latency_us.max > 0.0 && total.hz > 0.0);
}
