//! A publisher of a topic, and its messages that are missing.

use std::sync::Arc;

use sm2_proto::{Name, TypeId};

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
    /// How many messages were counted as missing before a later message shows it.
    announced: u64,
    /// How many messages were counted as displaced, as the numbers of later ones show, but for those whose other reason
    /// a look at the counters has found.
    shown: u64,
    /// How many of them the last look does not explain, because they came later.
    pub(super) unexplained: u64,
    /// How many messages were displaced, as the counters tell. The number of no later message may have shown it yet.
    pub(super) displaced: u64,
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
            announced: 0,
            shown: 0,
            unexplained: 0,
            displaced: 0,
            left: None,
        }
    }

    /// Adds messages that a later one shows as missing. Returns the number of those that were not announced before,
    /// which count as displaced. `is_explained`: the counters were read before.
    pub(super) fn show(&mut self, now_ns: u64, lost: u64, is_explained: bool) -> u64 {
        let displaced = self.not_announced(lost);
        self.shown += displaced;
        if !is_explained {
            self.unexplained += displaced;
        }
        self.lose(now_ns, displaced, GapReason::Displaced);
        displaced
    }

    /// Whether it has this name and type.
    pub(super) fn is(&self, name: &Name, data: &TypeId) -> bool {
        self.source.publisher == *name && self.source.data == *data
    }

    /// Has a new link. The counters of the one before have ended with it, and explain nothing any more.
    pub(super) fn begin_link(&mut self) {
        self.shown = (self.shown).min(self.displaced.saturating_add(self.unexplained));
    }

    /// Of messages that were not sent for a reason that the counters tell, those that no later message has shown: they
    /// are announced. The others were counted as displaced.
    ///
    /// Messages that were displaced explain themselves. Only if more were counted than the counters have can some of
    /// the count have this other reason. Otherwise these messages are behind the last one, and nothing else would count
    /// them if no other follows.
    pub(super) fn explain(&mut self, unsent: u64) -> u64 {
        let counted = self.shown.saturating_sub(self.displaced).min(unsent);
        self.shown -= counted;
        self.announced += unsent - counted;
        unsent - counted
    }

    /// Of messages that a later one shows as missing, those that were not announced before.
    const fn not_announced(&mut self, lost: u64) -> u64 {
        let displaced = lost.saturating_sub(self.announced);
        self.announced = self.announced.saturating_sub(lost);
        displaced
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

    #[test]
    fn a_loss_that_was_announced_is_counted_once() {
        let mut publisher = publisher();
        publisher.announced = 5;
        let displaced = [3, 1, 4, 2, 0].map(|lost| publisher.not_announced(lost));
        assert_eq!(displaced, [0, 0, 3, 2, 0]);
        assert_eq!(publisher.announced, 0);
    }

    #[test]
    fn messages_count_as_displaced_and_as_not_sent_only_if_they_were_not_displaced() {
        let mut publisher = publisher();
        // All of them were displaced, so those that were not sent are behind the last message.
        publisher.show(1, 10, false);
        publisher.displaced += 10;
        assert_eq!(publisher.explain(4), 4);
        assert_eq!(publisher.show(2, 6, false), 2);
        // One of these two was displaced.
        publisher.displaced += 1;
        assert_eq!(publisher.explain(3), 2);
        assert_eq!(publisher.show(3, 2, false), 0);
        // The counters have messages that no later one has shown.
        publisher.displaced += 5;
        assert_eq!(publisher.explain(3), 3);
        assert_eq!(publisher.show(4, 8, false), 5);
        assert_eq!(publisher.explain(1), 1);
    }

    #[test]
    fn the_losses_of_a_link_before_do_not_hide_those_of_the_next_one() {
        for (is_explained, expected) in [(true, 5), (false, 3)] {
            let mut publisher = publisher();
            publisher.show(1, 2, is_explained);
            publisher.begin_link();
            assert_eq!(publisher.explain(5), expected, "{is_explained}");
        }
    }
}
