//! Sampled operations on a scheduler, and the same topics as plain lists.

use std::{collections::BTreeMap, num::NonZero, time::Duration};

use proptest::{option, prelude::*};
use sm2_proto::{
    Instant, Machine,
    gateway::{
        OfferId,
        schedule::{DropCause, Input, Next, Output, SendQos},
    },
    limits::MESSAGES_IN_FLIGHT_MAX,
};

use super::{Bench, MS, drop};

/// More topics than may have a message in flight.
pub(crate) const TOPICS: usize = MESSAGES_IN_FLIGHT_MAX + 16;

/// One topic as plain lists.
#[derive(Default)]
struct Listed {
    /// The messages, and the times of their publication.
    waiting: Vec<(u64, Instant)>,
    in_flight: Option<u64>,
    last_started: Option<u64>,
}

#[derive(Clone, Debug)]
pub(crate) enum Op {
    /// Publishes a message of this offer with this length.
    Publish(u64, u64),
    /// Starts one of the messages that may start.
    Start(usize),
    /// Reports one of the messages in flight as sent.
    Sent(usize),
    /// Lets this many milliseconds pass.
    Wait(u64),
    /// Closes the topic of this offer, and opens it again.
    Close(u64),
    Change(u64, SendQos),
}

pub(crate) fn qos() -> impl Strategy<Value = SendQos> {
    let age = option::of((1_u64..60).prop_map(Duration::from_millis));
    (
        0_u16..4,
        0_u8..9,
        option::of(1_u32..100),
        option::of(1_u64..100_000),
        age,
    )
        .prop_map(|(depth, priority, messages, bytes, max_age)| SendQos {
            depth,
            priority,
            messages_per_s: messages.and_then(NonZero::new),
            bytes_per_s: bytes.and_then(NonZero::new),
            max_age,
        })
}

pub(crate) fn op() -> impl Strategy<Value = Op> {
    let offer = || prop_oneof![0_u64..4, 0..TOPICS as u64];
    prop_oneof![
        6 => (offer(), 0_u64..5_000).prop_map(|(offer, len)| Op::Publish(offer, len)),
        4 => (0..TOPICS).prop_map(Op::Start),
        4 => (0..TOPICS).prop_map(Op::Sent),
        3 => (0_u64..40).prop_map(Op::Wait),
        1 => offer().prop_map(Op::Close),
        1 => (offer(), qos()).prop_map(|(offer, qos)| Op::Change(offer, qos)),
    ]
}

/// Operations after which as many messages are in flight as may be, and others wait.
pub(crate) fn all_started() -> impl Iterator<Item = Op> {
    let published = (0..TOPICS as u64).map(|offer| Op::Publish(offer, 100 * offer));
    published.chain((0..TOPICS).map(|_| Op::Start(0)))
}

/// The scheduler, and the same topics as lists.
pub(crate) struct Compared {
    bench: Bench,
    qos: Vec<SendQos>,
    lists: BTreeMap<u64, Listed>,
}

impl Compared {
    pub(crate) fn new(qos: Vec<SendQos>) -> Self {
        let mut bench = Bench::new((0..).zip(qos.clone()));
        bench.starts_at_once = false;
        Self {
            bench,
            lists: (0..)
                .zip(&qos)
                .map(|(offer, _)| (offer, Listed::default()))
                .collect(),
            qos,
        }
    }

    fn list(&mut self, offer: u64) -> &mut Listed {
        self.lists.get_mut(&offer).unwrap()
    }

    /// Feeds one operation. A published message is `message`.
    pub(crate) fn apply(
        &mut self,
        message: u64,
        op: Op,
    ) -> Result<Vec<Output<u64>>, TestCaseError> {
        Ok(match op {
            Op::Publish(offer, len) => {
                let now = self.bench.now;
                self.list(offer).waiting.push((message, now));
                self.bench.publish(offer, message, len)
            }
            Op::Start(pick) => {
                let ready: Vec<_> = self.bench.ready().collect();
                if ready.is_empty() {
                    return Ok(Vec::new());
                }
                let offer = ready[pick % ready.len()];
                self.bench.input(Input::Start { offer })
            }
            Op::Sent(pick) => {
                let lists = self.lists.iter().filter(|(_, it)| it.in_flight.is_some());
                let in_flight: Vec<_> = lists.map(|(offer, _)| *offer).collect();
                if in_flight.is_empty() {
                    return Ok(Vec::new());
                }
                let offer = in_flight[pick % in_flight.len()];
                self.list(offer).in_flight = None;
                self.bench.sent(offer)
            }
            Op::Wait(ms) => {
                self.bench.now = Instant(self.bench.now.0 + ms * MS);
                self.bench.input(Input::Tick)
            }
            Op::Close(number) => {
                let offer = OfferId(number);
                let outputs = self.bench.input(Input::Close { offer });
                let list = std::mem::take(self.list(number));
                let reset = list.in_flight.map(|_| Output::Reset { offer });
                let withdrawn = |it: &(u64, _)| drop(number, it.0, DropCause::Withdrawn);
                let dropped = list.waiting.iter().map(withdrawn);
                let expected: Vec<_> = reset.into_iter().chain(dropped).collect();
                prop_assert_eq!(&outputs, &expected);
                let qos = self.qos[number as usize];
                self.bench.input(Input::Open { offer, qos })
            }
            Op::Change(number, qos) => {
                self.qos[number as usize] = qos;
                let offer = OfferId(number);
                self.bench.input(Input::Change { offer, qos })
            }
        })
    }

    /// Applies an output to the lists.
    pub(crate) fn follow(&mut self, output: &Output<u64>) -> Result<(), TestCaseError> {
        let now = self.bench.now;
        let (Output::Start { offer, message } | Output::Drop { offer, message, .. }) = output
        else {
            prop_assert!(false, "only when a topic is closed");
            return Ok(());
        };
        let qos = self.qos[offer.0 as usize];
        let list = self.list(offer.0);
        let most = usize::from(qos.depth.max(1));
        let is_too_many = list.waiting.len() > most;
        let Some((oldest, published)) = list.waiting.first().copied() else {
            return Err(TestCaseError::fail("the topic has no message"));
        };
        prop_assert_eq!(oldest, *message, "the oldest of its topic");
        list.waiting.remove(0);
        let is_old = qos.max_age.is_some_and(|it| now.since(published) > it);
        match output {
            Output::Start { .. } => {
                prop_assert!(list.in_flight.is_none() && list.last_started < Some(*message));
                prop_assert!(!is_old && !is_too_many);
                (list.in_flight, list.last_started) = (Some(*message), Some(*message));
            }
            Output::Drop { cause, .. } => {
                let is_true = match cause {
                    DropCause::Superseded => is_too_many,
                    DropCause::Expired => is_old && !is_too_many,
                    // There is no limit of memory, and `apply` compares what a closed topic drops.
                    DropCause::Displaced | DropCause::Withdrawn => false,
                };
                prop_assert!(is_true, "{cause:?}");
            }
            Output::Reset { .. } => {}
        }
        Ok(())
    }

    pub(crate) fn check(&self) -> Result<(), TestCaseError> {
        let order: Vec<_> = self.bench.schedule.order().collect();
        let mut starts = 0;
        for (number, list) in &self.lists {
            let qos = &self.qos[*number as usize];
            let offer = OfferId(*number);
            prop_assert!(list.waiting.len() <= usize::from(qos.depth.max(1)));
            let is_in_flight = list.in_flight.is_some();
            prop_assert_eq!(order.contains(&Next::Continue { offer }), is_in_flight);
            let is_ready = self.bench.schedule.next(offer).is_some();
            starts += usize::from(is_ready);
            let is_unlimited = qos.messages_per_s.is_none() && qos.bytes_per_s.is_none();
            let waits = !is_in_flight && !list.waiting.is_empty();
            prop_assert!(!is_ready || waits);
            prop_assert!(is_ready || !waits || !is_unlimited);
            let deadline = self.bench.schedule.deadline();
            let is_timed = deadline.is_some_and(|it| it > self.bench.now);
            prop_assert!(is_ready || !waits || is_timed);
            if let (Some((_, published)), Some(max_age)) = (list.waiting.first(), qos.max_age) {
                prop_assert!(self.bench.now.since(*published) <= max_age && is_timed);
            }
        }
        let in_flight = self.lists.values().filter(|it| it.in_flight.is_some());
        let in_flight = in_flight.count();
        prop_assert!(in_flight <= MESSAGES_IN_FLIGHT_MAX);
        let starts = starts.min(MESSAGES_IN_FLIGHT_MAX - in_flight);
        prop_assert_eq!(order.len(), in_flight + starts);
        Ok(())
    }
}
