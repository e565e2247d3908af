//! Which message goes to a peer next, against lists and a way that carries bytes in that order.

mod support;

use std::{
    collections::{BTreeMap, btree_map::Entry},
    num::NonZero,
    time::Duration,
};

use proptest::{collection::vec, option, prelude::*};
use sm2_proto::{
    Instant,
    gateway::{
        OfferId,
        schedule::{Cause, Input, Message, Misuse, Output, PRIORITY_MAX, Schedule, Terms},
    },
    limits::MESSAGES_IN_FLIGHT_MAX,
};
use support::cases;

const FREE: Terms = Terms {
    depth: 1,
    priority: 0,
    messages_per_s: None,
    bytes_per_s: None,
    max_age: None,
};
const MS: u64 = 1_000_000;

struct Bench {
    schedule: Schedule,
    now: Instant,
}

impl Bench {
    fn new(topics: impl IntoIterator<Item = (u64, Terms)>) -> Self {
        let mut bench = Self {
            schedule: Schedule::default(),
            now: Instant(0),
        };
        for (offer, terms) in topics {
            let offer = OfferId(offer);
            assert_eq!(bench.input(Input::Open { offer, terms }), []);
        }
        bench
    }

    fn input(&mut self, input: Input) -> Vec<Output> {
        let taken = self.schedule.handle(self.now, input);
        taken.unwrap_or_else(|misuse| panic!("{input:?}: {misuse}"));
        std::iter::from_fn(|| self.schedule.poll()).collect()
    }

    fn publish(&mut self, offer: u64, key: u64, len_bytes: u64) -> Vec<Output> {
        let message = Message {
            key,
            len_bytes,
            published: self.now,
        };
        let offer = OfferId(offer);
        self.input(Input::Message { offer, message })
    }

    fn at(&mut self, ms: u64) -> Vec<Output> {
        self.now = Instant(ms * MS);
        self.input(Input::Tick)
    }

    fn sent(&mut self, offer: u64) -> Vec<Output> {
        let offer = OfferId(offer);
        self.input(Input::Sent { offer })
    }

    fn order(&self) -> Vec<u64> {
        self.schedule.order().map(|it| it.0).collect()
    }
}

const fn start(offer: u64, key: u64) -> Output {
    let offer = OfferId(offer);
    Output::Start { offer, key }
}

const fn drop(key: u64, cause: Cause) -> Output {
    Output::Drop { key, cause }
}

//= SM2-GWM-004 test
#[test]
fn the_newest_waits_for_the_one_that_is_under_way() {
    let mut bench = Bench::new([(1, FREE)]);
    assert_eq!(bench.publish(1, 10, 100), [start(1, 10)]);
    assert_eq!(bench.publish(1, 11, 100), []);
    assert_eq!(bench.publish(1, 12, 100), [drop(11, Cause::Superseded)]);
    assert_eq!(bench.sent(1), [start(1, 12)]);
    assert_eq!(bench.sent(1), []);
    assert_eq!(bench.publish(1, 13, 100), [start(1, 13)]);
}

//= SM2-GWM-004 test
#[test]
fn as_many_as_the_peer_wants_in_their_order() {
    let mut bench = Bench::new([(1, Terms { depth: 3, ..FREE })]);
    assert_eq!(bench.publish(1, 0, 100), [start(1, 0)]);
    for key in 1..=3 {
        assert_eq!(bench.publish(1, key, 100), []);
    }
    assert_eq!(bench.publish(1, 4, 100), [drop(1, Cause::Superseded)]);
    assert_eq!(bench.sent(1), [start(1, 2)]);
    let terms = FREE;
    let changed = bench.input(Input::Change {
        offer: OfferId(1),
        terms,
    });
    assert_eq!(changed, [drop(3, Cause::Superseded)]);
    assert_eq!(bench.sent(1), [start(1, 4)]);
}

#[test]
fn a_short_message_overtakes_a_long_one_and_no_flood_of_them_does() {
    let mut bench = Bench::new([(1, FREE), (2, FREE)]);
    bench.publish(1, 0, 1_000);
    assert_eq!(bench.publish(2, 1, 400), [start(2, 1)]);
    assert_eq!(bench.order(), [2, 1]);
    bench.sent(2);
    bench.publish(2, 2, 400);
    assert_eq!(bench.order(), [2, 1]);
    bench.sent(2);
    bench.publish(2, 3, 400);
    assert_eq!(bench.order(), [1, 2], "it has had its share");
    bench.sent(1);
    bench.publish(1, 4, 100);
    assert_eq!(
        bench.order(),
        [1, 2],
        "what one waited for is not held against it"
    );
}

#[test]
fn priority_is_a_greater_share() {
    let urgent = Terms {
        priority: 2,
        ..FREE
    };
    let mut bench = Bench::new([(1, FREE), (2, urgent)]);
    bench.publish(1, 0, 1_000);
    bench.publish(2, 1, 3_999);
    assert_eq!(bench.order(), [2, 1]);
    let beyond = Terms {
        priority: 255,
        ..FREE
    };
    let most = Terms {
        priority: PRIORITY_MAX,
        ..FREE
    };
    let mut same = Bench::new([(1, most), (2, beyond)]);
    same.publish(2, 0, 1_000);
    same.publish(1, 1, 1_000);
    assert_eq!(same.order(), [1, 2], "equal turns, by their offers");
}

#[test]
fn whoever_was_silent_has_saved_nothing() {
    let mut bench = Bench::new([(1, FREE), (2, FREE)]);
    for key in 0..10 {
        bench.publish(1, key, 1_000);
        bench.sent(1);
    }
    bench.publish(1, 10, 1_000);
    bench.publish(2, 11, 600);
    assert_eq!(bench.order(), [2, 1]);
    bench.sent(2);
    bench.publish(2, 12, 600);
    assert_eq!(bench.order(), [1, 2]);
}

#[test]
fn so_many_messages_a_second() {
    let terms = Terms {
        messages_per_s: NonZero::new(10),
        ..FREE
    };
    let mut bench = Bench::new([(1, terms)]);
    assert_eq!(bench.publish(1, 0, 100), [start(1, 0)]);
    bench.sent(1);
    assert_eq!(bench.schedule.deadline(), None, "nothing waits");
    assert_eq!(bench.publish(1, 1, 100), []);
    assert_eq!(bench.schedule.deadline(), Some(Instant(100 * MS)));
    assert_eq!(bench.at(99), []);
    assert_eq!(bench.publish(1, 2, 100), [drop(1, Cause::Superseded)]);
    assert_eq!(bench.at(100), [start(1, 2)]);
    assert_eq!(bench.schedule.deadline(), None);
    // Other rules hold at once.
    bench.sent(1);
    assert_eq!(bench.publish(1, 3, 100), []);
    let changed = bench.input(Input::Change {
        offer: OfferId(1),
        terms: FREE,
    });
    assert_eq!(changed, [start(1, 3)]);
    assert_eq!(bench.schedule.deadline(), None);
}

#[test]
fn so_many_bytes_a_second() {
    let terms = Terms {
        messages_per_s: NonZero::new(1_000),
        bytes_per_s: NonZero::new(1_000),
        ..FREE
    };
    let mut bench = Bench::new([(1, terms)]);
    // One that is longer than the budget of a second goes, and is paid for afterwards.
    assert_eq!(bench.publish(1, 0, 2_500), [start(1, 0)]);
    bench.publish(1, 1, 0);
    assert_eq!(bench.at(2_499), []);
    assert_eq!(bench.sent(1), []);
    assert_eq!(bench.schedule.deadline(), Some(Instant(2_500 * MS)));
    assert_eq!(bench.at(2_500), [start(1, 1)]);
    // The stricter of both.
    bench.sent(1);
    bench.publish(1, 2, 0);
    assert_eq!(bench.schedule.deadline(), Some(Instant(2_501 * MS)));
    let mut forever = Bench::new([(1, terms)]);
    forever.publish(1, 0, u64::MAX);
    forever.sent(1);
    forever.publish(1, 1, 1);
    assert!(forever.schedule.deadline() > Some(Instant(u64::MAX / 2)));
}

#[test]
fn what_is_too_old_does_not_set_out() {
    let terms = Terms {
        depth: 2,
        max_age: Some(Duration::from_millis(50)),
        ..FREE
    };
    let mut bench = Bench::new([(1, terms)]);
    bench.publish(1, 0, 100);
    bench.publish(1, 1, 100);
    bench.at(30);
    bench.publish(1, 2, 100);
    bench.at(50);
    let just = bench.schedule.clone();
    bench.at(51);
    assert_eq!(bench.sent(1), [drop(1, Cause::Expired), start(1, 2)]);
    (bench.schedule, bench.now) = (just, Instant(50 * MS));
    assert_eq!(bench.sent(1), [start(1, 1)]);
}

#[test]
fn a_topic_that_is_closed_leaves_nothing() {
    let slow = Terms {
        messages_per_s: NonZero::new(1),
        ..FREE
    };
    let mut bench = Bench::new([(1, FREE), (2, slow)]);
    bench.publish(1, 0, 100);
    bench.publish(1, 1, 100);
    let withdrawn = |key| drop(key, Cause::Withdrawn);
    let closed = bench.input(Input::Close { offer: OfferId(1) });
    assert_eq!(closed, [Output::Reset { key: 0 }, withdrawn(1)]);
    bench.publish(2, 2, 100);
    bench.sent(2);
    bench.publish(2, 3, 100);
    assert_eq!(
        bench.input(Input::Close { offer: OfferId(2) }),
        [withdrawn(3)]
    );
    assert_eq!((bench.order(), bench.schedule.deadline()), (vec![], None));
    // Under the same number it is another one.
    bench.input(Input::Open {
        offer: OfferId(1),
        terms: FREE,
    });
    assert_eq!(bench.publish(1, 4, 100), [start(1, 4)]);
}

//= SM2-GWM-004 test
#[test]
fn no_more_in_the_making_than_streams() {
    let most = MESSAGES_IN_FLIGHT_MAX as u64;
    let mut bench = Bench::new((0..most + 3).map(|offer| (offer, FREE)));
    for offer in 0..most {
        assert_eq!(bench.publish(offer, offer, 1_000), [start(offer, offer)]);
    }
    for (offer, len_bytes) in [(most, 500), (most + 1, 100), (most + 2, 300)] {
        assert_eq!(bench.publish(offer, offer, len_bytes), []);
    }
    assert_eq!(
        bench.sent(0),
        [start(most + 1, most + 1)],
        "the shortest turn"
    );
    let closed = bench.input(Input::Close {
        offer: OfferId(most + 2),
    });
    assert_eq!(closed, [drop(most + 2, Cause::Withdrawn)]);
    assert_eq!(bench.sent(1), [start(most, most)]);
}

#[test]
fn what_a_driver_may_not_do() {
    let mut bench = Bench::new([(1, FREE)]);
    let before = bench.schedule.clone();
    let message = Message {
        key: 0,
        len_bytes: 1,
        published: Instant(0),
    };
    let table = [
        (
            Input::Open {
                offer: OfferId(1),
                terms: FREE,
            },
            Misuse::Open,
        ),
        (
            Input::Change {
                offer: OfferId(2),
                terms: FREE,
            },
            Misuse::NotOpen,
        ),
        (Input::Close { offer: OfferId(2) }, Misuse::NotOpen),
        (
            Input::Message {
                offer: OfferId(2),
                message,
            },
            Misuse::NotOpen,
        ),
        (Input::Sent { offer: OfferId(2) }, Misuse::NotOpen),
        (Input::Sent { offer: OfferId(1) }, Misuse::NotSending),
    ];
    for (input, expected) in table {
        assert_eq!(bench.schedule.handle(Instant(0), input), Err(expected));
        assert_eq!(bench.schedule, before);
    }
}

/// One topic as a list: what waits, and what is under way.
#[derive(Default)]
struct Listed {
    waiting: Vec<u64>,
    making: Option<u64>,
    last: Option<u64>,
}

#[derive(Clone, Debug)]
enum Op {
    Publish(u64, u64),
    Sent(usize),
    Wait(u64),
    Close(u64),
    Change(u64, Terms),
}

fn terms() -> impl Strategy<Value = Terms> {
    let age = option::of((1_u64..60).prop_map(Duration::from_millis));
    (
        0_u16..4,
        0_u8..9,
        option::of(1_u32..100),
        option::of(1_u64..100_000),
        age,
    )
        .prop_map(|(depth, priority, messages, bytes, max_age)| Terms {
            depth,
            priority,
            messages_per_s: messages.and_then(NonZero::new),
            bytes_per_s: bytes.and_then(NonZero::new),
            max_age,
        })
}

fn op() -> impl Strategy<Value = Op> {
    prop_oneof![
        6 => (0_u64..4, 0_u64..5_000).prop_map(|(offer, len)| Op::Publish(offer, len)),
        4 => (0_usize..4).prop_map(Op::Sent),
        3 => (0_u64..40).prop_map(Op::Wait),
        1 => (0_u64..4).prop_map(Op::Close),
        1 => (0_u64..4, terms()).prop_map(|(offer, terms)| Op::Change(offer, terms)),
    ]
}

proptest! {
    #![proptest_config(cases(400))]

    /// Each message goes out or is dropped, once; those of a topic in their order; and nothing
    /// that may go waits.
    //= SM2-GWM-004 test
    #[test]
    fn each_message_ends_once(all in vec(terms(), 4), ops in vec(op(), 1..120)) {
        let mut terms: Vec<Terms> = all;
        let mut bench = Bench::new((0..).zip(terms.clone()));
        let mut lists: BTreeMap<u64, Listed> = (0..4).map(|it| (it, Listed::default())).collect();
        for (key, op) in ops.into_iter().enumerate() {
            let key = key as u64;
            let outputs = match op {
                Op::Publish(offer, len) => {
                    lists.get_mut(&offer).unwrap().waiting.push(key);
                    bench.publish(offer, key, len)
                }
                Op::Sent(pick) => {
                    let order = bench.order();
                    if order.is_empty() {
                        continue;
                    }
                    let offer = order[pick % order.len()];
                    lists.get_mut(&offer).unwrap().making = None;
                    bench.sent(offer)
                }
                Op::Wait(ms) => {
                    bench.now = Instant(bench.now.0 + ms * MS);
                    bench.input(Input::Tick)
                }
                Op::Close(offer) => {
                    let outputs = bench.input(Input::Close { offer: OfferId(offer) });
                    let list = std::mem::take(lists.get_mut(&offer).unwrap());
                    let reset = list.making.map(|key| Output::Reset { key });
                    let dropped = list.waiting.iter().map(|&key| drop(key, Cause::Withdrawn));
                    prop_assert_eq!(&outputs, &reset.into_iter().chain(dropped).collect::<Vec<_>>());
                    bench.input(Input::Open { offer: OfferId(offer), terms: terms[offer as usize] })
                }
                Op::Change(offer, other) => {
                    terms[offer as usize] = other;
                    bench.input(Input::Change { offer: OfferId(offer), terms: other })
                }
            };
            for output in outputs {
                match output {
                    Output::Start { offer, key } => {
                        let list = lists.get_mut(&offer.0).unwrap();
                        prop_assert_eq!(list.waiting.first(), Some(&key));
                        prop_assert!(list.making.is_none() && list.last < Some(key));
                        list.waiting.remove(0);
                        (list.making, list.last) = (Some(key), Some(key));
                    }
                    Output::Drop { key, .. } => {
                        let list = lists.values_mut().find(|it| it.waiting.first() == Some(&key));
                        list.expect("the oldest of its topic").waiting.remove(0);
                    }
                    Output::Reset { .. } => prop_assert!(false, "only at the end of a topic"),
                }
            }
            for (offer, list) in &lists {
                let terms = &terms[*offer as usize];
                prop_assert!(list.waiting.len() <= usize::from(terms.depth.max(1)));
                prop_assert_eq!(bench.order().contains(offer), list.making.is_some());
                let is_free = terms.messages_per_s.is_none() && terms.bytes_per_s.is_none();
                prop_assert!(!is_free || list.making.is_some() || list.waiting.is_empty());
                let waits = list.making.is_none() && !list.waiting.is_empty();
                prop_assert!(!waits || bench.schedule.deadline().is_some_and(|it| it > bench.now));
            }
        }
    }

}

proptest! {
    #![proptest_config(cases(40))]

    /// Topics that always have something to send get the way by their priorities, but for what
    /// one message of each is long.
    #[test]
    fn shares_are_fair(priorities in vec(0_u8..4, 2..5), lens in vec(1_u64..2_000, 1..40)) {
        let topics = priorities.iter().map(|&priority| Terms { priority, ..FREE });
        let mut bench = Bench::new((0..).zip(topics));
        let mut key = 0;
        let mut left = BTreeMap::new();
        let mut carried = vec![0_u64; priorities.len()];
        for _ in 0..20_000 {
            for offer in 0..priorities.len() as u64 {
                if let Entry::Vacant(next) = left.entry(offer) {
                    let len = *next.insert(lens[(key as usize) % lens.len()]);
                    prop_assert_eq!(bench.publish(offer, key, len), [start(offer, key)]);
                    key += 1;
                }
            }
            // One packet.
            let first = bench.order()[0];
            let rest = left.get_mut(&first).unwrap();
            let packet = (*rest).min(100);
            *rest -= packet;
            carried[first as usize] += packet;
            if *rest == 0 {
                left.remove(&first);
                bench.sent(first);
            }
        }
        let shares: Vec<f64> = (carried.iter().zip(&priorities))
            .map(|(&bytes, &priority)| bytes as f64 / f64::from(1_u32 << priority))
            .collect();
        let most = shares.iter().copied().fold(0.0, f64::max);
        for (share, priority) in shares.iter().zip(&priorities) {
            let one_each = 2.0 * 2_000.0 * priorities.len() as f64;
            prop_assert!(most - share <= one_each, "{shares:?} of {priorities:?}: {priority}");
        }
    }
}
