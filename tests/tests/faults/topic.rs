//! A topic whose messages are checked and accounted for.

use std::{collections::BTreeSet, mem, time::Duration};

use sm2_node::{Publisher, Subscriber, diagnostics::LinkStatus};
use sm2_proto::link::End;
use sm2_tests::pattern::{is_intact, message};

use sm2_test_support::until;

use super::world::{World, patient};

/// A publisher and a subscriber of two nodes.
pub(crate) struct Topic {
    pub(crate) publisher: Publisher<[u8]>,
    pub(crate) subscriber: Subscriber<[u8]>,
    /// The messages that were sent on a link and were not taken.
    sent: BTreeSet<u64>,
    /// Those of them that were sent before the first one arrived.
    early: BTreeSet<u64>,
    /// How many messages were taken.
    received: u64,
}

impl Topic {
    pub(crate) fn new(publisher: Publisher<[u8]>, subscriber: Subscriber<[u8]>) -> Self {
        Self {
            publisher,
            subscriber,
            sent: BTreeSet::new(),
            early: BTreeSet::new(),
            received: 0,
        }
    }

    /// Waits until the two ends are linked.
    pub(crate) fn linked(self) -> Self {
        until("an open link", || {
            let open = |links: &[LinkStatus]| links.iter().any(|it| it.open);
            let (ours, theirs) = (self.publisher.links(), self.subscriber.links());
            open(&ours) && open(&theirs)
        });
        self
    }

    /// Publishes again and again until the first message arrives. Between the two ends, a gateway publishes as well: it
    /// may have had no link yet, so that the messages before were for nobody.
    pub(crate) fn heard(mut self, world: &mut World) -> Self {
        self.carry(world, 0);
        self.early = mem::take(&mut self.sent);
        self
    }

    /// Publishes a message of this length again and again until one arrives.
    pub(crate) fn carry(&mut self, world: &mut World, len: usize) {
        until("a message", || self.send(world, len));
    }

    /// Publishes a message. Returns whether it arrived soon.
    pub(crate) fn send(&mut self, world: &mut World, len: usize) -> bool {
        let serial = world.next_serial();
        let bytes = [&serial.to_le_bytes()[..], &message(serial, len)].concat();
        let published = patient("publish", || self.publisher.publish(&bytes));
        if published.links > 0 {
            self.sent.insert(serial);
        }
        self.takes(serial)
    }

    /// Whether this message arrives soon. Takes the messages before it, too.
    pub(crate) fn takes(&mut self, serial: u64) -> bool {
        for _ in 0..10 {
            // Drives the node of the publisher.
            self.publisher.links();
            match self.subscriber.recv_timeout(Duration::from_millis(2)) {
                Ok(Some(sample)) => {
                    let (head, bytes) = sample.split_at(8);
                    let came = u64::from_le_bytes(head.try_into().unwrap());
                    assert!(is_intact(bytes, came), "message {came} is damaged");
                    let is_new = self.sent.remove(&came) || self.early.remove(&came);
                    assert!(is_new, "message {came} came twice");
                    self.received += 1;
                    if came == serial {
                        return true;
                    }
                }
                Ok(None) => {}
                Err(error) => assert!(!error.to_string().is_empty()),
            }
        }
        false
    }

    /// How many messages were taken so far.
    pub(crate) fn received(&self) -> u64 {
        self.received
    }

    pub(crate) fn note_sent(&mut self, serial: u64) {
        self.sent.insert(serial);
    }

    /// Checks that each message that is missing was counted, and that nobody was accused.
    pub(crate) fn adds_up(self) {
        self.adds_up_beside(0);
    }

    /// As [`adds_up`](Self::adds_up), with messages that were counted between publisher and subscriber.
    pub(crate) fn adds_up_beside(mut self, between: u64) {
        while self.takes(0) {}
        let links = self.publisher.links();
        let ends = links
            .iter()
            .chain(&self.subscriber.links())
            .cloned()
            .collect::<Vec<_>>();
        for link in &ends {
            assert!(!matches!(link.end, Some(End::Violation(_))), "{link:?}");
        }
        let dropped = |link: &LinkStatus| {
            let counters = link.counters;
            let sum = counters.overwritten + counters.discarded + counters.no_room;
            sum + counters.closed + counters.pool_limit + counters.in_flight
        };
        let counted = links.iter().map(dropped).sum::<u64>() + self.subscriber.lost() + between;
        let missing = self.sent.len() as u64;
        assert!(
            missing <= counted,
            "{missing} messages are missing, {counted} counted: {links:?}"
        );
    }
}
