//! A publisher of a topic, and its messages that are missing.

use std::sync::Arc;

use sm2_proto::{Name, Period, TypeId};

use crate::gap::{Gap, GapReason};
use crate::queue::{Item, Queue};
use crate::source::Source;

/// A publisher of a topic that is recorded.
pub(super) struct Publisher {
    pub(super) source: Arc<Source>,
    /// The `log_time` of its last message that was recorded.
    pub(super) last_time: Option<u64>,
    /// When its first message was lost, as long as none is recorded.
    first_lost: Option<u64>,
    /// The gaps that the writer does not know yet, one for each reason.
    gaps: Vec<Gap>,
    /// How many messages were counted as missing, but for those that no later message would show.
    counted: u64,
    /// How many messages the numbers of later ones have shown as missing.
    shown: u64,
    /// How many of them the last look at the counters does not explain, because they came later.
    pub(super) unexplained: u64,
    /// How many messages were displaced, as the counters tell. The number of no later message may have shown it yet.
    displaced: u64,
    /// How many messages were not sent for another reason, as the counters tell. Some may be behind the last message.
    unsent: u64,
    /// Since it has left: how often all messages of the topic had been found before. Some of its own may be left.
    pub(super) left: Option<u64>,
}

impl Publisher {
    pub(super) fn new(source: Source) -> Self {
        Self {
            source: Arc::new(source),
            last_time: None,
            first_lost: None,
            gaps: Vec::new(),
            counted: 0,
            shown: 0,
            unexplained: 0,
            displaced: 0,
            unsent: 0,
            left: None,
        }
    }

    /// Adds messages that a later one shows as missing. Returns the number of those that were not counted before, which
    /// count as displaced. `is_explained`: the counters were read before.
    pub(super) fn show(&mut self, now_ns: u64, lost: u64, is_explained: bool) -> u64 {
        self.shown += lost;
        if !is_explained {
            self.unexplained += lost;
        }
        self.count(now_ns)
    }

    /// Whether it has this name and type.
    pub(super) fn is(&self, name: &Name, data: &TypeId) -> bool {
        self.source.publisher == *name && self.source.data == *data
    }

    /// Has a new link. The counters of the one before have ended with it, and explain nothing any more.
    pub(super) fn begin_link(&mut self) {
        let explained = self.shown.saturating_sub(self.unexplained);
        self.displaced = (self.displaced).max(explained.saturating_sub(self.unsent));
    }

    /// Adds messages that were displaced, as the counters tell.
    pub(super) fn displace(&mut self, messages: u64) {
        self.displaced += messages;
    }

    /// Adds messages that were not sent for this reason, as the counters tell. Returns the number of those that were
    /// not counted before.
    pub(super) fn explain(&mut self, now_ns: u64, unsent: u64, reason: GapReason) -> u64 {
        let was_missing = self.missing();
        self.unsent += unsent;
        let messages = self.missing().saturating_sub(was_missing.max(self.counted));
        self.counted += messages;
        self.lose(now_ns, messages, reason);
        messages
    }

    /// Counts what is missing and was not counted before as displaced. Returns the number of messages.
    pub(super) fn count(&mut self, now_ns: u64) -> u64 {
        let messages = self.missing().saturating_sub(self.counted);
        self.counted += messages;
        self.lose(now_ns, messages, GapReason::Displaced);
        messages
    }

    /// How many messages are missing, as far as the counters and the numbers of later messages tell. A message that was
    /// displaced has a later one, which shows it: so those that are shown are displaced ones first. All that were not
    /// sent and are not among them are behind the last message, and nothing else would count them if no other follows.
    /// A later message that has expired shows nothing.
    fn missing(&self) -> u64 {
        let displaced = match self.source.offer.lifespan == Period::NONE {
            true => self.shown.min(self.displaced),
            false => self.displaced,
        };
        (self.shown).max(self.unsent.saturating_add(displaced))
    }

    /// Adds messages that are missing now.
    pub(super) fn lose(&mut self, now_ns: u64, messages: u64, reason: GapReason) {
        if messages == 0 {
            return;
        }
        let first_lost = *self.first_lost.get_or_insert(now_ns);
        let gap = Gap {
            publisher: self.source.publisher.to_string(),
            from_ns: self.last_time.unwrap_or(first_lost),
            to_ns: now_ns,
            messages,
            reason,
        };
        if !self.gaps.iter_mut().any(|it| it.extend(&gap)) {
            self.gaps.push(gap);
        }
    }

    /// Passes the gaps to the writer.
    pub(super) fn flush_gaps(&mut self, queue: &Queue) {
        for gap in self.gaps.drain(..) {
            queue.push(Item::Gap(Arc::clone(&self.source), gap));
        }
    }
}

#[cfg(test)]
mod tests {
    use sm2_proto::link::Fate;

    use super::*;
    use crate::source::UNKNOWN_OFFER;

    fn publisher() -> Publisher {
        let name = |text| Name::new(text).unwrap();
        Publisher::new(Source {
            topic: name("scan"),
            publisher: name("lidar"),
            data: TypeId {
                name: name("u8"),
                hash: 1,
            },
            offer: UNKNOWN_OFFER,
            schema: None,
        })
    }

    const POOL_LIMIT: GapReason = GapReason::Unsent(Fate::PoolLimit);

    #[test]
    fn a_loss_that_was_announced_is_counted_once() {
        let mut publisher = publisher();
        assert_eq!(publisher.explain(1, 5, POOL_LIMIT), 5);
        let displaced = [3, 1, 4, 2, 0].map(|lost| publisher.show(2, lost, true));
        assert_eq!(displaced, [0, 0, 3, 2, 0]);
    }

    #[test]
    fn messages_count_as_displaced_and_as_not_sent_only_if_they_were_not_displaced() {
        let mut publisher = publisher();
        // All of them were displaced, so those that were not sent are behind the last message.
        publisher.show(1, 10, false);
        publisher.displace(10);
        assert_eq!(publisher.explain(1, 4, POOL_LIMIT), 4);
        assert_eq!(publisher.show(2, 6, false), 2);
        // One of these two was displaced.
        publisher.displace(1);
        assert_eq!(publisher.explain(2, 3, POOL_LIMIT), 2);
        assert_eq!(publisher.show(3, 2, false), 0);
    }

    /// Whether the counters are read before or after a message shows what was displaced.
    #[test]
    fn messages_that_were_displaced_hide_none_that_were_not_sent_behind_the_last_one() {
        let displaced = 9;
        for is_known_before in [true, false] {
            let mut publisher = publisher();
            if is_known_before {
                publisher.displace(displaced);
            }
            assert_eq!(publisher.explain(1, 30, POOL_LIMIT), 30);
            let shown = publisher.show(2, displaced, true);
            if !is_known_before {
                publisher.displace(displaced);
            }
            assert_eq!(shown + publisher.count(3), displaced, "{is_known_before}");
        }
    }

    #[test]
    fn messages_that_were_displaced_by_expired_ones_are_counted() {
        let mut publisher = publisher();
        publisher.displace(4);
        assert_eq!(publisher.count(1), 0);
        let source = Arc::make_mut(&mut publisher.source);
        source.offer.lifespan = Period(2);
        assert_eq!(publisher.count(1), 4);
        assert_eq!(publisher.show(2, 4, true), 0);
    }

    #[test]
    fn the_losses_of_a_link_before_do_not_hide_those_of_the_next_one() {
        for (is_explained, expected) in [(true, 5), (false, 3)] {
            let mut publisher = publisher();
            publisher.show(1, 2, is_explained);
            publisher.begin_link();
            assert_eq!(
                publisher.explain(2, 5, POOL_LIMIT),
                expected,
                "{is_explained}"
            );
        }
    }
}
