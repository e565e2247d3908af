//! The scheduler of messages to a peer, compared with plain lists, and with a link that carries
//! packets in its order.

// Shows GW-SHARE (proptest), bound: cases; sampled events of 80 topics; shares of up to four that never rest; the wait
// of each of 200 topics.

mod bounds;
mod lists;

use std::{
    collections::{BTreeMap, btree_map::Entry},
    num::NonZero,
    time::Duration,
};

use crate::support::cases;
use lists::{Compared, TOPICS, all_started, op, qos};
use proptest::{collection::vec, prelude::*};
use sm2_proto::{
    Error, Instant, Machine,
    gateway::{
        OfferId,
        schedule::{
            DropCause, Input, Misuse, Next, Output, PRIORITY_MAX, QueuedMessage, Schedule, SendQos,
        },
    },
    limits::MESSAGES_IN_FLIGHT_MAX,
};

const FREE: SendQos = SendQos {
    depth: 1,
    priority: 0,
    messages_per_s: None,
    bytes_per_s: None,
    max_age: None,
};
const MS: u64 = 1_000_000;

/// A scheduler whose messages are numbers, and a clock.
struct Bench {
    schedule: Schedule<u64>,
    now: Instant,
    /// True if each message that may start does so at once, as if the link were idle.
    starts_at_once: bool,
}

impl Bench {
    fn new(topics: impl IntoIterator<Item = (u64, SendQos)>) -> Self {
        Self::with_budget(u64::MAX, topics)
    }

    fn with_budget(max_bytes: u64, topics: impl IntoIterator<Item = (u64, SendQos)>) -> Self {
        let mut bench = Self {
            schedule: Schedule::new(max_bytes),
            now: Instant(0),
            starts_at_once: true,
        };
        for (offer, qos) in topics {
            let offer = OfferId(offer);
            assert_eq!(bench.input(Input::Open { offer, qos }), []);
        }
        bench
    }

    fn input(&mut self, input: Input<u64>) -> Vec<Output<u64>> {
        let taken = self.schedule.handle(self.now, input.clone());
        taken.unwrap_or_else(|misuse| panic!("{input:?}: {misuse}"));
        let mut outputs: Vec<_> = std::iter::from_fn(|| self.schedule.poll()).collect();
        let next = self.ready().next().filter(|_| self.starts_at_once);
        if let Some(offer) = next {
            outputs.extend(self.input(Input::Start { offer }));
        }
        outputs
    }

    /// The offers of messages that may start, in their order.
    fn ready(&self) -> impl Iterator<Item = OfferId> {
        let next = |it| match it {
            Next::Start { offer } => Some(offer),
            Next::Continue { .. } => None,
        };
        self.schedule.order().filter_map(next)
    }

    fn publish(&mut self, offer: u64, message: u64, len_bytes: u64) -> Vec<Output<u64>> {
        let message = QueuedMessage {
            message,
            len_bytes,
            published_at: self.now,
        };
        let offer = OfferId(offer);
        self.input(Input::Enqueue { offer, message })
    }

    fn at(&mut self, ms: u64) -> Vec<Output<u64>> {
        self.now = Instant(ms * MS);
        self.input(Input::Tick)
    }

    fn sent(&mut self, offer: u64) -> Vec<Output<u64>> {
        let offer = OfferId(offer);
        self.input(Input::Sent { offer })
    }

    fn order(&self) -> Vec<u64> {
        self.schedule.order().map(|it| it.offer().0).collect()
    }
}

const fn start(offer: u64, message: u64) -> Output<u64> {
    let offer = OfferId(offer);
    Output::Start { offer, message }
}

const fn drop(offer: u64, message: u64, cause: DropCause) -> Output<u64> {
    Output::Drop {
        offer: OfferId(offer),
        message,
        cause,
    }
}

//= SM2-GWM-004 test
#[test]
fn the_newest_waits_for_the_message_in_flight() {
    let mut bench = Bench::new([(1, FREE)]);
    assert_eq!(bench.publish(1, 10, 100), [start(1, 10)]);
    assert_eq!(bench.publish(1, 11, 100), []);
    assert_eq!(
        bench.publish(1, 12, 100),
        [drop(1, 11, DropCause::Superseded)]
    );
    assert_eq!(bench.sent(1), [start(1, 12)]);
    assert_eq!(bench.sent(1), []);
    assert_eq!(bench.publish(1, 13, 100), [start(1, 13)]);
}

//= SM2-GWM-004 test
#[test]
fn as_many_as_the_peer_wants_in_their_order() {
    let mut bench = Bench::new([(1, SendQos { depth: 3, ..FREE })]);
    assert_eq!(bench.publish(1, 0, 100), [start(1, 0)]);
    for key in 1..=3 {
        assert_eq!(bench.publish(1, key, 100), []);
    }
    assert_eq!(
        bench.publish(1, 4, 100),
        [drop(1, 1, DropCause::Superseded)]
    );
    assert_eq!(bench.sent(1), [start(1, 2)]);
    let changed = bench.input(Input::Change {
        offer: OfferId(1),
        qos: FREE,
    });
    assert_eq!(changed, [drop(1, 3, DropCause::Superseded)]);
    assert_eq!(bench.sent(1), [start(1, 4)]);
}

#[test]
fn above_the_memory_budget_the_largest_queue_loses_its_oldest_message() {
    let deep = SendQos { depth: 10, ..FREE };
    let displaced = |offer, message| [drop(offer, message, DropCause::Displaced)];
    let mut bench = Bench::with_budget(1_000, [(1, deep), (2, deep)]);
    assert_eq!(bench.publish(1, 0, 300), [start(1, 0)]);
    assert_eq!(bench.publish(2, 1, 100), [start(2, 1)]);
    assert_eq!(bench.publish(1, 2, 300), []);
    assert_eq!(bench.publish(2, 3, 200), []);
    assert_eq!(bench.publish(1, 4, 300), displaced(1, 2));
    assert_eq!(bench.publish(2, 5, 200), displaced(2, 3));
    assert_eq!(bench.publish(2, 6, 100), [], "as much as fits");
    assert_eq!(bench.sent(1), [start(1, 4)]);
    // A message in flight stays, so this one has no room.
    assert_eq!(bench.publish(1, 7, 900), displaced(1, 7));
    let closed = bench.input(Input::Close { offer: OfferId(1) });
    assert_eq!(closed, [Output::Reset { offer: OfferId(1) }]);
    assert_eq!(
        bench.publish(2, 8, 600),
        [],
        "what was closed takes no room"
    );
    assert_eq!(bench.publish(2, 9, 100), displaced(2, 5));
    let limit = |max_bytes| Input::Limit { max_bytes };
    assert_eq!(bench.input(limit(900)), []);
    assert_eq!(bench.input(limit(899)), displaced(2, 6));
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
    assert_eq!(bench.order(), [1, 2], "topic 2 has had its share");
    bench.sent(1);
    bench.publish(1, 4, 100);
    assert_eq!(bench.order(), [1, 2], "waiting costs topic 1 no share");
}

#[test]
fn priority_is_a_greater_share() {
    let urgent = SendQos {
        priority: 2,
        ..FREE
    };
    let mut bench = Bench::new([(1, FREE), (2, urgent)]);
    bench.publish(1, 0, 1_000);
    bench.publish(2, 1, 3_999);
    assert_eq!(bench.order(), [2, 1]);
    let beyond = SendQos {
        priority: 255,
        ..FREE
    };
    let most = SendQos {
        priority: PRIORITY_MAX,
        ..FREE
    };
    let mut same = Bench::new([(1, most), (2, beyond)]);
    same.publish(2, 0, 1_000);
    same.publish(1, 1, 1_000);
    assert_eq!(
        same.order(),
        [1, 2],
        "equal finish tags: the smaller offer first"
    );
}

#[test]
fn an_idle_topic_saves_up_no_share() {
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
fn the_rate_of_messages_is_limited() {
    let qos = SendQos {
        messages_per_s: NonZero::new(10),
        ..FREE
    };
    let mut bench = Bench::new([(1, qos)]);
    assert_eq!(bench.publish(1, 0, 100), [start(1, 0)]);
    bench.sent(1);
    assert_eq!(bench.schedule.deadline(), None, "nothing waits");
    assert_eq!(bench.publish(1, 1, 100), []);
    assert_eq!(bench.schedule.deadline(), Some(Instant(100 * MS)));
    assert_eq!(bench.at(99), []);
    assert_eq!(
        bench.publish(1, 2, 100),
        [drop(1, 1, DropCause::Superseded)]
    );
    assert_eq!(bench.at(100), [start(1, 2)]);
    assert_eq!(bench.schedule.deadline(), None);
    // Changed limits apply at once.
    bench.sent(1);
    assert_eq!(bench.publish(1, 3, 100), []);
    let changed = bench.input(Input::Change {
        offer: OfferId(1),
        qos: FREE,
    });
    assert_eq!(changed, [start(1, 3)]);
    assert_eq!(bench.schedule.deadline(), None);
}

#[test]
fn the_rate_of_bytes_is_limited() {
    let qos = SendQos {
        messages_per_s: NonZero::new(1_000),
        bytes_per_s: NonZero::new(1_000),
        ..FREE
    };
    let mut bench = Bench::new([(1, qos)]);
    // A message longer than the bytes of a second starts, and delays the next one accordingly.
    assert_eq!(bench.publish(1, 0, 2_500), [start(1, 0)]);
    bench.publish(1, 1, 0);
    assert_eq!(bench.at(2_499), []);
    assert_eq!(bench.sent(1), []);
    assert_eq!(bench.schedule.deadline(), Some(Instant(2_500 * MS)));
    assert_eq!(bench.at(2_500), [start(1, 1)]);
    // The stricter of both limits applies.
    bench.sent(1);
    bench.publish(1, 2, 0);
    assert_eq!(bench.schedule.deadline(), Some(Instant(2_501 * MS)));
    let mut forever = Bench::new([(1, qos)]);
    forever.publish(1, 0, u64::MAX);
    forever.sent(1);
    forever.publish(1, 1, 1);
    assert!(forever.schedule.deadline() > Some(Instant(u64::MAX / 2)));
}

#[test]
fn an_expired_message_does_not_start() {
    let qos = SendQos {
        depth: 2,
        max_age: Some(Duration::from_millis(50)),
        ..FREE
    };
    let mut bench = Bench::new([(1, qos)]);
    bench.publish(1, 0, 100);
    bench.publish(1, 1, 100);
    bench.at(30);
    bench.publish(1, 2, 100);
    bench.at(50);
    let just = bench.schedule.clone();
    assert_eq!(bench.schedule.deadline(), Some(Instant(50 * MS + 1)));
    assert_eq!(bench.at(51), [drop(1, 1, DropCause::Expired)]);
    assert_eq!(bench.sent(1), [start(1, 2)]);
    (bench.schedule, bench.now) = (just, Instant(50 * MS));
    assert_eq!(bench.sent(1), [start(1, 1)]);
}

#[test]
fn a_closed_topic_leaves_nothing() {
    let slow = SendQos {
        messages_per_s: NonZero::new(1),
        ..FREE
    };
    let mut bench = Bench::new([(1, FREE), (2, slow)]);
    bench.publish(1, 0, 100);
    bench.publish(1, 1, 100);
    let withdrawn = |offer, message| drop(offer, message, DropCause::Withdrawn);
    let closed = bench.input(Input::Close { offer: OfferId(1) });
    assert_eq!(
        closed,
        [Output::Reset { offer: OfferId(1) }, withdrawn(1, 1)]
    );
    bench.publish(2, 2, 100);
    bench.sent(2);
    bench.publish(2, 3, 100);
    assert_eq!(
        bench.input(Input::Close { offer: OfferId(2) }),
        [withdrawn(2, 3)]
    );
    assert_eq!((bench.order(), bench.schedule.deadline()), (vec![], None));
    // The same number opened again is a new topic.
    bench.input(Input::Open {
        offer: OfferId(1),
        qos: FREE,
    });
    assert_eq!(bench.publish(1, 4, 100), [start(1, 4)]);
}

//= SM2-GWM-004 test
#[test]
fn the_number_of_messages_in_flight_is_limited() {
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
        "the smallest finish tag"
    );
    let closed = bench.input(Input::Close {
        offer: OfferId(most + 2),
    });
    assert_eq!(closed, [drop(most + 2, most + 2, DropCause::Withdrawn)]);
    assert_eq!(bench.sent(1), [start(most, most)]);
}

#[test]
fn misuse_changes_nothing() {
    let mut bench = Bench::new([(1, FREE)]);
    let before = bench.schedule.clone();
    let message = QueuedMessage {
        message: 0,
        len_bytes: 1,
        published_at: Instant(0),
    };
    let table = [
        (
            Input::Open {
                offer: OfferId(1),
                qos: FREE,
            },
            Misuse::Open,
        ),
        (
            Input::Change {
                offer: OfferId(2),
                qos: FREE,
            },
            Misuse::NotOpen,
        ),
        (Input::Close { offer: OfferId(2) }, Misuse::NotOpen),
        (
            Input::Enqueue {
                offer: OfferId(2),
                message,
            },
            Misuse::NotOpen,
        ),
        (Input::Start { offer: OfferId(2) }, Misuse::NotOpen),
        (Input::Start { offer: OfferId(1) }, Misuse::NotReady),
        (Input::Sent { offer: OfferId(2) }, Misuse::NotOpen),
        (Input::Sent { offer: OfferId(1) }, Misuse::NotSending),
    ];
    for (input, expected) in table {
        let misuse = Err(Error::Misuse(expected));
        assert_eq!(bench.schedule.handle(Instant(0), input), misuse);
        assert_eq!(bench.schedule, before);
    }
}

proptest! {
    #![proptest_config(cases(100))]

    /// Each message is started or dropped once, for a reason that holds. The messages of a topic start
    /// in their order and none too old, and no message waits that may start.
    //= SM2-GWM-004, SM2-GWM-006 test
    #[test]
    fn each_message_ends_once(all in vec(qos(), TOPICS), ops in vec(op(), 1..120)) {
        let mut compared = Compared::new(all);
        for (message, op) in (0..).zip(all_started().chain(ops)) {
            for output in compared.apply(message, op)? {
                compared.follow(&output)?;
            }
            compared.check()?;
        }
    }

}

proptest! {
    #![proptest_config(cases(40))]

    /// Topics that always have a message get shares of the link by their priorities, up to the
    /// length of one message of each.
    #[test]
    fn shares_are_fair(priorities in vec(0_u8..4, 2..5), lens in vec(1_u64..2_000, 1..40)) {
        let topics = priorities.iter().map(|&priority| SendQos { priority, ..FREE });
        let mut bench = Bench::new((0..).zip(topics));
        let mut message = 0;
        let mut left = BTreeMap::new();
        let mut carried = vec![0_u64; priorities.len()];
        for _ in 0..20_000 {
            for offer in 0..priorities.len() as u64 {
                if let Entry::Vacant(next) = left.entry(offer) {
                    let len = *next.insert(lens[(message as usize) % lens.len()]);
                    prop_assert_eq!(bench.publish(offer, message, len), [start(offer, message)]);
                    message += 1;
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
            let slack = 2.0 * 2_000.0 * priorities.len() as f64;
            prop_assert!(most - share <= slack, "{shares:?} of {priorities:?}: {priority}");
        }
    }
}
