//! `subscriber`: checks every message of a topic.

use std::{collections::HashMap, time::Duration};

use sm2_node::{Node, RecvError, Sample, Subscriber, diagnostics::LinkStatus};
use sm2_tests::options::Options;

use super::work::Work;
use crate::{message, tally::Tally};

pub(super) struct Subscribing {
    subscriber: Subscriber<[u8]>,
    numbers: Numbers,
}

impl Subscribing {
    pub(super) fn new(node: &Node, options: &Options) -> Self {
        Self {
            subscriber: subscriber(node, options),
            numbers: Numbers::default(),
        }
    }
}

pub(super) fn subscriber(node: &Node, options: &Options) -> Subscriber<[u8]> {
    let topic: String = options.get("--topic").expect("--topic");
    let subscriber = node.subscriber_builder::<[u8]>(&topic);
    let subscriber = subscriber
        .depth(options.get_or("--depth", 16))
        .max_borrowed(options.get_or("--borrow", 2))
        .reliable(options.get_or("--reliable", false))
        .sealed(options.get_or("--sealed", false));
    subscriber.declare().expect("a subscriber")
}

impl Work for Subscribing {
    fn turn(&mut self, tally: &mut Tally) {
        match self.subscriber.recv_timeout(Duration::from_millis(5)) {
            Ok(Some(sample)) => {
                self.numbers.check(&sample, tally);
            }
            // A process without descriptors or memory loses a link, which both ends count.
            Ok(None) | Err(RecvError::Map { .. }) => {}
            Err(error) => tally.error(&error.to_string()),
        }
    }

    fn set_resting(&mut self, _resting: bool) {}

    fn is_settled(&mut self) -> bool {
        true
    }

    fn links(&self) -> Vec<LinkStatus> {
        self.subscriber.links()
    }
}

/// The last message of each publisher: its instance and its number.
#[derive(Default)]
pub(super) struct Numbers(HashMap<String, (u64, u64)>);

impl Numbers {
    /// Checks every byte of a message, and that it is newer than the message before. Returns its
    /// publisher's instance and its number if it is intact.
    pub(super) fn check(&mut self, sample: &Sample<[u8]>, tally: &mut Tally) -> Option<(u64, u64)> {
        tally.checked += 1;
        let publisher = sample.publisher().as_str();
        let sequence = sample.sequence();
        let of = || format!("message {sequence} of {publisher}, {} bytes", sample.len());
        let Some((instance, number)) = message::check(sample) else {
            tally.damaged(&of());
            return None;
        };
        if number != sequence {
            tally.damaged(&format!("{} has number {number}", of()));
        }
        let last = self.0.insert(publisher.to_owned(), (instance, number));
        if let Some((before, last)) = last
            && before == instance
            && number <= last
        {
            tally.unaccounted(1, &format!("{} after number {last}", of()));
        }
        Some((instance, number))
    }
}
