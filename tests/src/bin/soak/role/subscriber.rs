//! `subscriber`: checks every message of a topic.

use std::{collections::HashMap, time::Duration};

use sm2_node::{Node, RecvError, Sample, Subscriber, diagnostics::LinkStatus};
use sm2_tests::options::Options;

use super::work::{Work, patient};
use crate::{message, tally::Tally};

pub(super) struct Subscribing {
    subscriber: Subscriber<[u8]>,
    numbers: Numbers,
}

impl Subscribing {
    pub(super) fn new(node: &Node, options: &Options) -> Self {
        Self {
            subscriber: subscriber(node, options),
            numbers: Numbers::new(options),
        }
    }
}

pub(super) fn subscriber(node: &Node, options: &Options) -> Subscriber<[u8]> {
    let topic: String = options.get("--topic").expect("--topic");
    patient("subscriber", || {
        let subscriber = node.subscriber_builder::<[u8]>(&topic);
        subscriber
            .depth(options.get_or("--depth", 16))
            .max_borrowed(options.get_or("--borrow", 2))
            .reliable(options.get_or("--reliable", false))
            .sealed(options.get_or("--sealed", false))
            .declare()
    })
}

impl Work for Subscribing {
    fn turn(&mut self, tally: &mut Tally) {
        match self.subscriber.recv_timeout(Duration::from_millis(5)) {
            Ok(Some(sample)) => {
                self.numbers.check(&sample, tally);
            }
            Ok(None) => {}
            // A process without descriptors or memory loses a message, which no sample reports, and perhaps a link.
            Err(RecvError::Map { .. }) => self.numbers.forget(),
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

/// The number of the last message of each publisher and instance: gateways publish for several of them.
#[derive(Default)]
pub(super) struct Numbers {
    last: HashMap<(String, u64), Last>,
    /// Whether the messages come through gateways: these number messages anew.
    is_remote: bool,
}

struct Last {
    number: u64,
    /// Whether each message after it is taken or reported as lost.
    is_exact: bool,
}

impl Numbers {
    pub(super) fn new(options: &Options) -> Self {
        Self {
            last: HashMap::new(),
            is_remote: options.get_or("--remote", false),
        }
    }

    /// A message was lost that no sample reports.
    fn forget(&mut self) {
        for last in self.last.values_mut() {
            last.is_exact = false;
        }
    }

    /// Checks every byte of a message, that it is newer than the message before, and that each message between the two
    /// is counted as lost: over the life of the pair, each publication is taken or lost, on whatever link it came or
    /// came not. Returns its publisher's instance and its number if it is intact.
    //= SM2-QOS-013 sys
    pub(super) fn check(&mut self, sample: &Sample<[u8]>, tally: &mut Tally) -> Option<(u64, u64)> {
        tally.checked += 1;
        tally.remote += u64::from(self.is_remote);
        let publisher = sample.publisher().as_str();
        let sequence = sample.sequence();
        let of = || format!("message {sequence} of {publisher}, {} bytes", sample.len());
        let Some((instance, number)) = message::check(sample) else {
            tally.damaged(&of());
            return None;
        };
        if number != sequence && !self.is_remote {
            tally.damaged(&format!("{} has number {number}", of()));
        }
        let is_exact = true;
        let last = Last { number, is_exact };
        if let Some(last) = self.last.insert((publisher.to_owned(), instance), last) {
            let Last {
                number: before,
                is_exact,
            } = last;
            if number <= before {
                tally.unaccounted(1, &format!("{} after number {before}", of()));
            } else if is_exact && !self.is_remote {
                let lost = sample.lost();
                let unaccounted = (number - before - 1).abs_diff(lost);
                if unaccounted > 0 {
                    let what = format!("{} after number {before}, {lost} lost", of());
                    tally.unaccounted(unaccounted, &what);
                }
            }
        }
        Some((instance, number))
    }
}
