//! Sampled operations on a scheduler, and the same topics as plain lists.

use std::{collections::BTreeMap, num::NonZero, time::Duration};

use proptest::{option, prelude::*};
use sm2_proto::{
    Instant, Machine,
    gateway::{
        OfferId,
        schedule::{DropCause, Input, Output, SendQos},
    },
};

use super::{Bench, MS, drop};

/// One topic as plain lists.
#[derive(Default)]
struct Listed {
    waiting: Vec<u64>,
    in_flight: Option<u64>,
    last_started: Option<u64>,
}

#[derive(Clone, Debug)]
pub(crate) enum Op {
    /// Publishes a message of this offer with this length.
    Publish(u64, u64),
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
    prop_oneof![
        6 => (0_u64..4, 0_u64..5_000).prop_map(|(offer, len)| Op::Publish(offer, len)),
        4 => (0_usize..4).prop_map(Op::Sent),
        3 => (0_u64..40).prop_map(Op::Wait),
        1 => (0_u64..4).prop_map(Op::Close),
        1 => (0_u64..4, qos()).prop_map(|(offer, qos)| Op::Change(offer, qos)),
    ]
}

/// The scheduler, and the same topics as lists.
pub(crate) struct Compared {
    bench: Bench,
    qos: Vec<SendQos>,
    lists: BTreeMap<u64, Listed>,
}

impl Compared {
    pub(crate) fn new(qos: Vec<SendQos>) -> Self {
        Self {
            bench: Bench::new((0..).zip(qos.clone())),
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
                self.list(offer).waiting.push(message);
                self.bench.publish(offer, message, len)
            }
            Op::Sent(pick) => {
                let order = self.bench.order();
                if order.is_empty() {
                    return Ok(Vec::new());
                }
                let offer = order[pick % order.len()];
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
                let withdrawn = |&message: &u64| drop(number, message, DropCause::Withdrawn);
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
        match output {
            Output::Start { offer, message } => {
                let list = self.list(offer.0);
                prop_assert_eq!(list.waiting.first(), Some(message));
                prop_assert!(list.in_flight.is_none() && list.last_started < Some(*message));
                list.waiting.remove(0);
                (list.in_flight, list.last_started) = (Some(*message), Some(*message));
            }
            Output::Drop { offer, message, .. } => {
                let list = self.list(offer.0);
                prop_assert_eq!(
                    list.waiting.first(),
                    Some(message),
                    "the oldest of its topic"
                );
                list.waiting.remove(0);
            }
            Output::Reset { .. } => prop_assert!(false, "only when a topic is closed"),
        }
        Ok(())
    }

    pub(crate) fn check(&self) -> Result<(), TestCaseError> {
        for (offer, list) in &self.lists {
            let qos = &self.qos[*offer as usize];
            prop_assert!(list.waiting.len() <= usize::from(qos.depth.max(1)));
            prop_assert_eq!(self.bench.order().contains(offer), list.in_flight.is_some());
            let is_unlimited = qos.messages_per_s.is_none() && qos.bytes_per_s.is_none();
            let waits = list.in_flight.is_none() && !list.waiting.is_empty();
            prop_assert!(!is_unlimited || !waits);
            let deadline = self.bench.schedule.deadline();
            prop_assert!(!waits || deadline.is_some_and(|it| it > self.bench.now));
        }
        Ok(())
    }
}
