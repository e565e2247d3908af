//! Losses on the way to the recorder, and their reasons.
//!
//! The numbers of a publisher's messages show that some are missing before a message, but not why. The publisher
//! knows: the counters of its node, which tools can read, have the fates of the messages of each link. The recorder
//! reads them when messages are missing, at intervals while losses are likely that no later message shows, and at the
//! end. So the messages behind the last one are counted as well. When a publisher ends, its counters end with it; what
//! it dropped behind its last message is then known up to the last look.

use std::collections::{BTreeSet, HashMap};
use std::time::Duration;

use sm2_node::diagnostics::{CounterView, Counters, LinkStatus};
use sm2_node::domain::{Domain, QueryError};
use sm2_node::{Node, Sample};
use sm2_proto::{Instant, Name};

use super::Recorder;
use crate::queue::HeldBy;

/// The counters of the publishers of a topic whose messages are displaced are read this often at most.
const LOOK_AGAIN: Duration = Duration::from_millis(20);
/// Losses that no later message shows are looked for this often.
const LOOK_INTERVAL: Duration = Duration::from_millis(500);
/// A Manager that did not answer is not asked for this time: the messages come first.
const ASK_AGAIN: Duration = Duration::from_secs(60);

/// The counters of nodes, for one look.
struct Views {
    opened: HashMap<Name, Option<CounterView>>,
    /// Whether the Manager answers.
    can_ask: bool,
}

impl Views {
    fn new(recorder: &Recorder<'_>) -> Self {
        Self {
            opened: HashMap::new(),
            can_ask: recorder.node.is_connected() && sm2_io::clock::now() >= recorder.ask_at,
        }
    }

    /// The fates of the messages of a link; `None` if the node of the publisher does not tell.
    fn fates(&mut self, node: &Node, domain: &Domain, link: &LinkStatus) -> Option<Counters> {
        if !link.open {
            return None;
        }
        let name = &link.peer.name;
        if !self.opened.contains_key(name) {
            let view = self.open(node, domain, link);
            self.opened.insert(name.clone(), view);
        }
        let view = self.opened.get(name)?.as_ref()?;
        let entries = view.entries().filter_map(|it| it.1.ok());
        let mut entries = entries.filter(|it| it.link == Some(link.id));
        entries.next().map(|it| it.fates)
    }

    fn open(&mut self, node: &Node, domain: &Domain, link: &LinkStatus) -> Option<CounterView> {
        if !self.can_ask {
            return None;
        }
        let peer = &link.peer;
        let id = match node.epoch() == Some(link.id.epoch) {
            true => peer.node,
            // A link outlives its Manager, and the next one numbers the nodes anew.
            false => domain.node_named(peer.name.as_str())?.node,
        };
        let inspected = node.inspect(id);
        self.can_ask = !matches!(
            inspected,
            Err(QueryError::TimedOut | QueryError::ManagerGone(_))
        );
        inspected.ok().flatten()
    }
}

impl Recorder<'_> {
    /// Counts the messages that are missing before this one. The counters tell the reasons.
    pub(super) fn count_lost(&mut self, number: usize, sample: &Sample<[u8]>, at: Instant) {
        if sample.lost() == 0 {
            return;
        }
        let topic = &self.topics[number];
        let is_late = topic
            .losses
            .looked_at
            .is_none_or(|it| at.since(it) >= LOOK_AGAIN);
        // An overload displaces messages all the time, and nothing else does.
        let is_due = is_late || topic.may_lose_unnoticed();
        if is_due {
            self.look_at_losses(|it| *it == number);
            // A look for other reasons does not count: the loss that follows it would have none.
            self.topics[number].losses.looked_at = Some(at);
        }
        let now = self.clock.wall_at(at);
        self.lost += self.topics[number].count_lost(&self.node, sample, now, is_due);
        self.has_gaps = true;
    }

    /// Looks for losses that no later message shows: on links whose messages wait for the disk in the memory of their
    /// publishers, on reliable links, and where messages have a lifespan.
    pub(super) fn look_for_losses(&mut self) {
        let now = sm2_io::clock::now();
        if now < self.look_at {
            return;
        }
        self.look_at = now.after(LOOK_INTERVAL);
        let (topics, queue) = (&self.topics, &self.queue);
        let is_to_look =
            |it: &usize| topics[*it].may_lose_unnoticed() || queue.held(HeldBy(*it)) > 0;
        let numbers: BTreeSet<_> = (0..topics.len()).filter(is_to_look).collect();
        if !numbers.is_empty() {
            self.look_at_losses(|it| numbers.contains(it));
        }
    }

    /// Looks for the losses of these topics.
    pub(super) fn look_at_losses(&mut self, is_to_look: impl Fn(&usize) -> bool) {
        let at = (self.options.monotonic_clock)();
        let now = self.clock.wall_at(at);
        let mut views = Views::new(self);
        let (node, domain) = (&self.node, self.watch.domain());
        let could_ask = views.can_ask;
        for number in (0..self.topics.len()).filter(is_to_look) {
            let topic = &mut self.topics[number];
            let fates = |link: &LinkStatus| views.fates(node, domain, link);
            let lost = topic.look_at_losses(node, now, fates);
            self.lost += lost;
            self.has_gaps |= lost > 0;
        }
        if could_ask && !views.can_ask {
            self.ask_at = sm2_io::clock::now().after(ASK_AGAIN);
        }
    }

    /// Passes gaps to the writer, unless it waits for room: they would fill the memory.
    pub(super) fn flush_gaps(&mut self) {
        if !self.has_gaps || self.queue.lacks_room() {
            return;
        }
        self.has_gaps = false;
        let queue = &self.queue;
        self.topics.iter_mut().for_each(|it| it.flush_gaps(queue));
    }
}
