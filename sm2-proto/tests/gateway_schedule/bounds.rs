//! How long a message waits at most: by its age, and by the share of its topic.

use std::{collections::BTreeMap, time::Duration};

use sm2_proto::{
    Instant, Machine,
    gateway::{
        OfferId,
        schedule::{DropCause, Input, Next, Output, SendQos},
    },
};

use super::{Bench, FREE, MS, drop};

//= SM2-GWM-006 test
#[test]
fn a_message_that_waits_for_the_link_expires() {
    let qos = SendQos {
        max_age: Some(Duration::from_millis(100)),
        ..FREE
    };
    let mut bench = Bench::new([(1, FREE), (2, qos)]);
    bench.starts_at_once = false;
    let expired = |message| [drop(2, message, DropCause::Expired)];
    bench.publish(1, 0, 1_000);
    assert_eq!(bench.publish(2, 1, 10), []);
    assert_eq!(bench.order(), [2, 1]);
    assert_eq!(bench.at(100), []);
    assert_eq!(bench.at(101), expired(1), "without any other event");
    assert_eq!(bench.order(), [1]);
    assert_eq!(bench.schedule.deadline(), None);
    // The driver starts a message at the very time when it expires.
    bench.publish(2, 2, 10);
    bench.now = Instant(202 * MS);
    let offer = OfferId(2);
    assert_eq!(bench.input(Input::Start { offer }), expired(2));
    // A message that expired keeps the place of its topic.
    bench.input(Input::Start { offer: OfferId(1) });
    bench.sent(1);
    for key in 3..6 {
        bench.publish(1, key, 1);
        bench.publish(2, 10 + key, 900);
        assert_eq!(bench.order(), [2, 1], "topic 2 waits for longer");
        bench.at(202 + 101 * (key - 2));
    }
}

/// A link that is never idle carries 200 topics, which publish faster than it can send.
//= SM2-GWM-005 test
#[test]
fn each_of_200_topics_is_served_within_its_share() {
    const PACKET_BYTES: u64 = 1_000;
    let priority = |offer: usize| (offer % 4) as u8;
    let longest = |offer: usize| 1_000 + (offer as u64 * 977) % 9_000;
    let topics = (0..200).map(|offer| {
        let priority = priority(offer);
        (offer as u64, SendQos { priority, ..FREE })
    });
    let mut bench = Bench::new(topics);
    bench.starts_at_once = false;
    // The bytes that each topic has sent; in `since`, when another topic began to wait.
    let mut carried = vec![0_u64; 200];
    let mut since = vec![None; 200];
    let (mut left, mut served) = (BTreeMap::new(), vec![0; 200]);
    for packet in 0..12_000 {
        if packet % 100 == 0 {
            for (offer, since) in since.iter_mut().enumerate() {
                let len = longest(offer) - packet % 900;
                bench.publish(offer as u64, len, len);
                since.get_or_insert_with(|| carried.clone());
            }
        }
        let Some(next) = bench.schedule.order().next() else {
            continue;
        };
        let offer = next.offer().0 as usize;
        if let Next::Start { offer: first } = next {
            let [Output::Start { message: len, .. }] =
                bench.input(Input::Start { offer: first })[..]
            else {
                panic!("{first:?} does not start");
            };
            left.insert(offer, len);
        }
        let rest = left.get_mut(&offer).unwrap();
        let bytes = PACKET_BYTES.min(*rest);
        *rest -= bytes;
        carried[offer] += bytes;
        if *rest > 0 {
            continue;
        }
        bench.sent(offer as u64);
        served[offer] += 1;
        let before: Vec<u64> = since[offer].take().unwrap();
        for other in (0..200).filter(|it| *it != offer) {
            let share = (longest(offer) << priority(other)) >> priority(offer);
            let most = longest(other) + share;
            assert!(
                carried[other] - before[other] <= most,
                "{other} before {offer}"
            );
        }
        if bench.schedule.next(OfferId(offer as u64)).is_some() {
            since[offer] = Some(carried.clone());
        }
    }
    assert!(served.iter().all(|it| *it > 0), "{served:?}");
}
