//! `late`: subscribes to a latched topic again and again. It must get the latched messages each
//! time.

use std::time::{Duration, Instant};

use sm2_node::{Node, Subscriber, diagnostics::LinkStatus};
use sm2_tests::{TIMEOUT, options::Options};

use super::{
    subscriber::{Numbers, subscriber},
    work::Work,
};
use crate::tally::Tally;

pub(super) struct Late {
    node: Node,
    options: Options,
    subscriber: Option<Subscriber<[u8]>>,
    /// The number of messages that the publisher keeps.
    latched: u64,
    since: Instant,
    /// The numbers of the messages that this subscriber got.
    got: Vec<u64>,
    resting: bool,
}

impl Late {
    pub(super) fn new(node: &Node, options: &Options) -> Self {
        Self {
            node: node.clone(),
            options: options.clone(),
            subscriber: None,
            latched: options.get("--latched").expect("--latched"),
            since: Instant::now(),
            got: Vec::new(),
            resting: false,
        }
    }

    /// Ends a round: all messages came, or the time is over.
    fn finish(&mut self, tally: &mut Tally) {
        let missing = self.latched.saturating_sub(self.got.len() as u64);
        if missing > 0 {
            let numbers = &self.got;
            tally.unaccounted(missing, &format!("latched messages besides {numbers:?}"));
        }
        self.subscriber = None;
        self.got.clear();
    }
}

impl Work for Late {
    fn turn(&mut self, tally: &mut Tally) {
        if self.subscriber.is_none() {
            if self.resting {
                std::thread::sleep(Duration::from_millis(5));
                return;
            }
            self.subscriber = Some(subscriber(&self.node, &self.options));
            self.since = Instant::now();
        }
        let subscriber = self.subscriber.as_ref().expect("declared above");
        if let Ok(Some(sample)) = subscriber.recv_timeout(Duration::from_millis(5)) {
            let number = Numbers::new(&self.options).check(&sample, tally);
            self.got.extend(number.map(|(_, number)| number));
        }
        // A node that was stopped does not find its time over before it looked for messages.
        if self.got.len() as u64 >= self.latched || self.since.elapsed() > TIMEOUT {
            self.finish(tally);
        }
    }

    fn set_resting(&mut self, resting: bool) {
        self.resting = resting;
    }

    fn is_settled(&mut self) -> bool {
        self.subscriber.is_none()
    }

    fn links(&self) -> Vec<LinkStatus> {
        self.subscriber
            .as_ref()
            .map_or_else(Vec::new, Subscriber::links)
    }
}
