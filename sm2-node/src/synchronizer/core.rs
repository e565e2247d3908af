//! The decisions of a synchronizer, without messages: only their inputs and times.

use sm2_proto::Instant;

use super::approximate::{Options, Search};
use super::exact;
use super::queues::{InputCounters, Output, Queues, Unused};

/// Decides which messages are a set and which are dropped.
///
/// The owner of the messages calls [`handle`](Self::handle) for each message, and then [`poll`](Self::poll) until it
/// returns `None`. It does not read a clock: times are values of the messages.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub(super) struct Core {
    queues: Queues,
    policy: Policy,
    /// The most messages of an input that are held between two calls of `handle`.
    queue_max: usize,
    sets: u64,
}

/// Which messages are a set.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
enum Policy {
    Exact,
    Approximate(Search),
}

impl Core {
    pub(super) fn exact(inputs: usize, queue_max: usize) -> Self {
        Self::new(inputs, queue_max, Policy::Exact)
    }

    pub(super) fn approximate(options: Options, queue_max: usize) -> Self {
        let inputs = options.min_periods_ns.len();
        Self::new(inputs, queue_max, Policy::Approximate(Search::new(options)))
    }

    fn new(inputs: usize, queue_max: usize, policy: Policy) -> Self {
        Self {
            queues: Queues::new(inputs),
            policy,
            queue_max,
            sets: 0,
        }
    }

    /// Handles a message of an input.
    pub(super) fn handle(&mut self, input: usize, time: Instant) {
        let min_period_ns = match &self.policy {
            Policy::Exact => 0,
            Policy::Approximate(search) => search.min_period_ns(input),
        };
        if !self.queues.push(input, time, min_period_ns) {
            return;
        }
        self.process();
        if self.queues.len(input) > self.queue_max {
            if let Policy::Approximate(search) = &mut self.policy {
                search.overflow(input);
            }
            self.queues.drop_oldest(input, Unused::Overflow);
            self.process();
        }
    }

    /// The next output.
    pub(super) fn poll(&mut self) -> Option<Output> {
        let output = self.queues.poll()?;
        self.sets += u64::from(output == Output::Set);
        Some(output)
    }

    /// The next output, unless it is a set.
    pub(super) fn poll_drop(&mut self) -> Option<Output> {
        match self.queues.peek() {
            Some(Output::Set) | None => None,
            Some(_) => self.poll(),
        }
    }

    /// Whether there is an output.
    pub(super) fn has_output(&self) -> bool {
        self.queues.peek().is_some()
    }

    /// The time of the newest message of an input.
    pub(super) fn newest(&self, input: usize) -> Option<Instant> {
        self.queues.newest(input)
    }

    pub(super) fn counters(&self, input: usize) -> InputCounters {
        self.queues.counters(input)
    }

    /// The number of sets that were polled.
    pub(super) const fn sets(&self) -> u64 {
        self.sets
    }

    /// Drops all messages, and forgets the times that have come.
    pub(super) fn clear(&mut self) {
        self.queues.clear();
        if let Policy::Approximate(search) = &mut self.policy {
            search.clear();
        }
    }

    fn process(&mut self) {
        match &mut self.policy {
            Policy::Exact => exact::process(&mut self.queues),
            Policy::Approximate(search) => search.process(&mut self.queues),
        }
    }
}
