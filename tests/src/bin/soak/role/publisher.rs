//! `publisher`: sends messages at a rate, or, if it is latched, a few at each `go`.

use std::time::{Duration, Instant};

use sm2_node::{Node, PublishError, Publisher, StoreError, diagnostics::LinkStatus};
use sm2_tests::{options::Options, random::Random};

use super::work::{Work, patient, random_len};
use crate::{
    message::{self, HEADER_BYTES},
    tally::Tally,
};

/// How long a message waits for reliable subscribers: much shorter than most stops.
const PATIENCE: Duration = Duration::from_millis(20);

pub(super) struct Publishing {
    node: Node,
    publisher: Publisher<[u8]>,
    instance: u64,
    number: u64,
    random: Random,
    /// The range of lengths, in bytes.
    lengths: (usize, usize),
    period: Duration,
    due: Instant,
    latched: u16,
    /// How many latched messages are still to be sent.
    remaining: u16,
    resting: bool,
    /// Whether the last message before the rest has reached all links.
    complete: bool,
}

impl Publishing {
    pub(super) fn new(node: &Node, options: &Options) -> Self {
        let topic: String = options.get("--topic").expect("--topic");
        let latched = options.get_or("--latched", 0);
        let rate: u32 = options.get_or("--rate", 1);
        let publisher = patient("publisher", || {
            let publisher = node.publisher_builder::<[u8]>(&topic);
            publisher
                .depth(options.get_or("--depth", 16))
                .latched(latched)
                .reliable(true)
                .publish_timeout(PATIENCE)
                .declare()
        });
        let most = options.get_or("--most", 1_000);
        let instance = message::new_instance();
        Self {
            node: node.clone(),
            publisher,
            instance,
            number: 0,
            random: Random::new(instance),
            lengths: (options.get_or("--least", HEADER_BYTES), most),
            period: Duration::from_secs(1) / rate,
            due: Instant::now(),
            latched,
            remaining: latched,
            resting: false,
            complete: false,
        }
    }

    /// Returns whether all reliable subscribers got the message. A system without memory or
    /// descriptors for it is not a fault of this process: nobody got the message then.
    fn publish(&mut self, tally: &mut Tally) -> bool {
        let (least, most) = self.lengths;
        let len = random_len(&mut self.random, least, most);
        let mut message = match self.publisher.loan_slice(len) {
            Ok(message) => message,
            Err(StoreError::Io(_)) => return false,
            Err(error) => {
                tally.error(&format!("{}: {error}", self.publisher.topic()));
                return false;
            }
        };
        message::fill(&mut message, self.instance, self.number + 1);
        match message.publish() {
            Ok(published) => {
                self.number += 1;
                published.missed == 0
            }
            Err(PublishError::Store(StoreError::Io(_))) => false,
            Err(error) => {
                tally.error(&format!("{}: {error}", self.publisher.topic()));
                false
            }
        }
    }
}

impl Work for Publishing {
    fn turn(&mut self, tally: &mut Tally) {
        let idle = Duration::from_millis(5);
        let wait = match self.resting && self.complete {
            true => idle,
            false => self.due.saturating_duration_since(Instant::now()).min(idle),
        };
        if !wait.is_zero() {
            let driven = self.node.spin_once_timeout(wait);
            driven.expect("the node's own wait");
            return;
        }
        // At most one period behind, however long this process was stopped.
        self.due = (self.due + self.period).max(Instant::now());
        if self.resting {
            // The receiver counts a loss with the next message, so the last one must arrive.
            self.complete = self.publish(tally);
        } else if self.latched == 0 {
            self.publish(tally);
        } else if self.remaining > 0 {
            self.remaining -= u16::from(self.publish(tally));
        }
    }

    fn set_resting(&mut self, resting: bool) {
        self.resting = resting;
        self.complete = false;
        self.remaining = self.latched;
    }

    fn is_settled(&mut self) -> bool {
        self.complete && matches!(self.publisher.flush_timeout(PATIENCE), Ok(true))
    }

    fn links(&self) -> Vec<LinkStatus> {
        self.publisher.links()
    }
}
