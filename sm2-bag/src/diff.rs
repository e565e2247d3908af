//! Comparing the payloads of two bags.

use std::collections::{BTreeMap, BTreeSet, VecDeque};
use std::fmt;

use serde::Serialize;

use crate::bag::Bag;
use crate::error::ReadError;
use crate::messages::{BagMessage, Filter};

/// The first difference of two bags, in the order of their messages.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
#[serde(tag = "difference", rename_all = "snake_case")]
pub enum Difference {
    /// Only one of the bags has the topic.
    Topic {
        /// The topic.
        topic: String,
        /// The bag that has it: 0 or 1.
        only_in: usize,
    },
    /// One of the bags has no such message.
    Count {
        /// The topic.
        topic: String,
        /// The number of the first message that only one bag has; the first message of a topic has number 0.
        message: u64,
        /// The bag that has it: 0 or 1.
        only_in: usize,
    },
    /// A message has another payload.
    Payload {
        /// The topic.
        topic: String,
        /// The number of the message; the first one of a topic has number 0.
        message: u64,
        /// The place of the first byte that differs; the length of the shorter payload, if the longer one begins
        /// with it.
        byte: usize,
    },
}

impl fmt::Display for Difference {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let bag = |only_in: &usize| ["first", "second"][*only_in];
        match self {
            Self::Topic { topic, only_in } => {
                write!(f, "only the {} bag has topic {topic}", bag(only_in))
            }
            Self::Count {
                topic,
                message,
                only_in,
            } => write!(
                f,
                "only the {} bag has message {message} of {topic}",
                bag(only_in)
            ),
            Self::Payload {
                topic,
                message,
                byte,
            } => write!(f, "message {message} of {topic} differs at byte {byte}"),
        }
    }
}

/// Compares the payloads of two bags, topic by topic. Times, publishers and gaps may differ. The messages that are
/// ahead of those of the same topic in the other bag are kept in memory.
///
/// # Errors
///
/// [`ReadError`].
pub fn diff(bags: [&Bag; 2]) -> Result<Option<Difference>, ReadError> {
    let topics = bags.map(|bag| {
        let channels = bag.sources().map(|(channel, _)| channel.topic.clone());
        channels.collect::<BTreeSet<_>>()
    });
    if let Some(topic) = topics[0].symmetric_difference(&topics[1]).next() {
        return Ok(Some(Difference::Topic {
            topic: topic.clone(),
            only_in: usize::from(topics[1].contains(topic)),
        }));
    }
    let filter = Filter::default();
    let mut messages = [bags[0].messages(&filter)?, bags[1].messages(&filter)?];
    let mut compared = BTreeMap::<String, Compared>::new();
    loop {
        let mut at_end = true;
        for (bag, messages) in messages.iter_mut().enumerate() {
            let Some(message) = messages.next().transpose()? else {
                continue;
            };
            at_end = false;
            let topic = &message.channel.topic;
            let of_topic = match compared.get_mut(topic) {
                Some(it) => it,
                None => compared.entry(topic.clone()).or_default(),
            };
            let difference = of_topic.add(bag, message);
            if difference.is_some() {
                return Ok(difference);
            }
        }
        if at_end {
            break;
        }
    }
    let mut rest = compared.into_iter();
    Ok(rest.find_map(|(topic, it)| it.rest(topic)))
}

/// The comparison of one topic.
#[derive(Default)]
struct Compared {
    /// How many messages are the same.
    same: u64,
    /// The messages of the bag that is ahead, and its number.
    ahead: VecDeque<BagMessage>,
    ahead_bag: usize,
}

impl Compared {
    /// Compares a message with its counterpart, or keeps it until that comes.
    fn add(&mut self, bag: usize, message: BagMessage) -> Option<Difference> {
        if self.ahead.is_empty() || self.ahead_bag == bag {
            self.ahead_bag = bag;
            self.ahead.push_back(message);
            return None;
        }
        let other = self.ahead.pop_front()?;
        match first_difference(&other.data, &message.data) {
            Some(byte) => Some(Difference::Payload {
                topic: message.channel.topic.clone(),
                message: self.same,
                byte,
            }),
            None => {
                self.same += 1;
                None
            }
        }
    }

    /// The difference after the last message of both bags.
    fn rest(self, topic: String) -> Option<Difference> {
        (!self.ahead.is_empty()).then_some(Difference::Count {
            topic,
            message: self.same,
            only_in: self.ahead_bag,
        })
    }
}

/// The place of the first byte that differs.
fn first_difference(a: &[u8], b: &[u8]) -> Option<usize> {
    let differs = a.iter().zip(b).position(|(a, b)| a != b);
    differs.or_else(|| (a.len() != b.len()).then_some(a.len().min(b.len())))
}
