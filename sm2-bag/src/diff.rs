//! Comparing the payloads of two bags.

use std::collections::{BTreeMap, BTreeSet, VecDeque};
use std::fmt;
use std::hash::{BuildHasher, RandomState};
use std::slice;

use serde::Serialize;

use crate::bag::Bag;
use crate::damaged::DamagedPart;
use crate::error::ReadError;
use crate::latched::messages;
use crate::messages::Filter;
use crate::observer::{Observer, report_progress, unobserved};
use crate::repeated::is_repeated;

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

/// The result of a comparison.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Comparison {
    /// The first difference. Messages in damaged parts are as if they had never been there.
    pub difference: Option<Difference>,
    /// The parts of both bags that are damaged, as far as the bags were read.
    pub damaged: [Vec<DamagedPart>; 2],
}

/// Compares the payloads of two bags, topic by topic. Times, publishers, gaps and repeated messages may differ. Of each
/// message that is ahead of those of the same topic in the other bag, the length and a hash of 64 bits are kept in
/// memory. The keys of the hash are random, so two payloads that differ count as the same with a probability of 2^-64.
///
/// # Errors
///
/// [`ReadError`].
pub fn diff(bags: [&Bag; 2]) -> Result<Comparison, ReadError> {
    diff_observed(bags.map(slice::from_ref), &mut unobserved)
}

/// As [`diff`], of two bags that may have several files. The observer is told about the payloads.
///
/// # Errors
///
/// [`ReadError`].
pub fn diff_observed(
    bags: [&[Bag]; 2],
    observer: &mut Observer<'_>,
) -> Result<Comparison, ReadError> {
    let damaged = bags.map(|files| files.iter().flat_map(Bag::damaged));
    let mut damaged = damaged.map(|it| it.cloned().collect());
    let difference = first(bags, &mut damaged, observer)?;
    Ok(Comparison {
        difference,
        damaged,
    })
}

/// Finds the first difference, and the damaged parts before it.
fn first(
    bags: [&[Bag]; 2],
    damaged: &mut [Vec<DamagedPart>; 2],
    observer: &mut Observer<'_>,
) -> Result<Option<Difference>, ReadError> {
    let topics = bags.map(|files| {
        let channels = files.iter().flat_map(Bag::channels);
        let channels = channels.filter(|it| !is_repeated(it));
        let channels = channels.map(|it| it.topic.clone());
        channels.collect::<BTreeSet<_>>()
    });
    if let Some(topic) = topics[0].symmetric_difference(&topics[1]).next() {
        return Ok(Some(Difference::Topic {
            topic: topic.clone(),
            only_in: usize::from(topics[1].contains(topic)),
        }));
    }
    let filter = Filter::default();
    let mut messages = bags.map(|files| messages(files, &filter));
    let mut compared = BTreeMap::<String, Compared>::new();
    let keys = RandomState::new();
    loop {
        let mut at_end = true;
        for (bag, messages) in messages.iter_mut().enumerate() {
            let message = match messages.next().map(|(_, it)| it) {
                None => continue,
                Some(Err(ReadError::Damaged { part, .. })) => {
                    at_end = false;
                    damaged[bag].push(part);
                    continue;
                }
                Some(message) => message?,
            };
            at_end = false;
            if message.is_repeated() {
                continue;
            }
            report_progress(observer, message.data.len() as u64)?;
            let topic = &message.channel.topic;
            let of_topic = match compared.get_mut(topic) {
                Some(it) => it,
                None => compared.entry(topic.clone()).or_default(),
            };
            if !of_topic.add(bag, Digest::of(&message.data, &keys)) {
                return payload_difference(bags, topic, of_topic.same).map(Some);
            }
        }
        if at_end {
            break;
        }
    }
    let mut rest = compared.into_iter();
    Ok(rest.find_map(|(topic, it)| it.difference_at_end(topic)))
}

/// The part of a payload that is compared.
#[derive(Clone, Copy, PartialEq, Eq)]
struct Digest {
    len: usize,
    hash: u64,
}

impl Digest {
    fn of(data: &[u8], keys: &RandomState) -> Self {
        Self {
            len: data.len(),
            hash: keys.hash_one(data),
        }
    }
}

/// The comparison of one topic.
#[derive(Default)]
struct Compared {
    /// How many messages are the same.
    same: u64,
    /// The messages of the bag that is ahead, and its number.
    ahead: VecDeque<Digest>,
    ahead_bag: usize,
}

impl Compared {
    /// Compares a message with its counterpart, or keeps it until that comes. Returns false if they differ.
    fn add(&mut self, bag: usize, message: Digest) -> bool {
        if self.ahead_bag != bag
            && let Some(other) = self.ahead.pop_front()
        {
            let is_same = other == message;
            self.same += u64::from(is_same);
            return is_same;
        }
        self.ahead_bag = bag;
        self.ahead.push_back(message);
        true
    }

    /// The difference after the last message of both bags.
    fn difference_at_end(self, topic: String) -> Option<Difference> {
        (!self.ahead.is_empty()).then_some(Difference::Count {
            topic,
            message: self.same,
            only_in: self.ahead_bag,
        })
    }
}

/// Reads a message of both bags again, whose payloads differ.
fn payload_difference(
    bags: [&[Bag]; 2],
    topic: &str,
    message: u64,
) -> Result<Difference, ReadError> {
    let [first, second] = bags.map(|files| payload(files, topic, message));
    Ok(Difference::Payload {
        topic: topic.to_owned(),
        message,
        byte: first_difference(&first?, &second?),
    })
}

/// The payload of the message with this number.
fn payload(files: &[Bag], topic: &str, message: u64) -> Result<Vec<u8>, ReadError> {
    let filter = Filter {
        topics: [topic.to_owned()].into(),
        ..Filter::default()
    };
    let mut before = message;
    for (_, message) in messages(files, &filter) {
        let message = match message {
            Err(ReadError::Damaged { .. }) => continue,
            message => message?,
        };
        // A filter also chooses the topic with a slash at its start.
        if message.channel.topic != topic || message.is_repeated() {
            continue;
        }
        if before == 0 {
            return Ok(message.data);
        }
        before -= 1;
    }
    // The file has changed since the message was read.
    Ok(Vec::new())
}

/// The place of the first byte that differs.
fn first_difference(a: &[u8], b: &[u8]) -> usize {
    let differs = a.iter().zip(b).position(|(a, b)| a != b);
    differs.unwrap_or(a.len().min(b.len()))
}
