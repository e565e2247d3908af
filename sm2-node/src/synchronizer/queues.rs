//! The times of the messages that a synchronizer holds, and the fates of messages.

use std::collections::VecDeque;

use sm2_proto::Instant;

/// The fates of the messages of one input of a [`Synchronizer`](crate::Synchronizer).
///
/// `received` is the sum of all others but `too_soon`.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
#[non_exhaustive]
pub struct InputCounters {
    /// The messages that were taken from the subscriber.
    pub received: u64,
    /// The messages that are held, and may still be part of a set.
    pub held: u64,
    /// The messages that were part of a set.
    pub used: u64,
    /// The messages that were dropped because no set has them: another message fits better, or the other inputs have
    /// none that fits.
    pub unmatched: u64,
    /// The messages that were dropped because the input held as many as its
    /// [queue](crate::synchronizer::SynchronizerBuilder::queue) allows.
    pub overflow: u64,
    /// The messages that were dropped because their time is before that of an earlier message of this input.
    pub out_of_order: u64,
    /// The messages that came sooner after the one before than [`Input::min_period`](super::Input::min_period) says.
    /// They are used like all others.
    pub too_soon: u64,
}

/// Work for the owner of the messages, which holds those of each input in the order of their arrival.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(super) enum Output {
    /// Drop the oldest message of this input.
    DropOldest(usize),
    /// Drop the newest message of this input.
    DropNewest(usize),
    /// The oldest messages of all inputs are a set.
    Set,
}

/// Why a message that was held is dropped.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Unused {
    Unmatched,
    Overflow,
}

/// The times of the messages that are held, the oldest first, and the outputs.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub(super) struct Queues {
    held: Vec<VecDeque<Instant>>,
    newest: Vec<Option<Instant>>,
    counters: Vec<InputCounters>,
    outputs: VecDeque<Output>,
}

impl Queues {
    pub(super) fn new(inputs: usize) -> Self {
        Self {
            held: vec![VecDeque::new(); inputs],
            newest: vec![None; inputs],
            counters: vec![InputCounters::default(); inputs],
            outputs: VecDeque::new(),
        }
    }

    pub(super) fn inputs(&self) -> usize {
        self.held.len()
    }

    pub(super) fn len(&self, input: usize) -> usize {
        self.held[input].len()
    }

    /// The time of the message `at`, counted from the oldest one.
    pub(super) fn time(&self, input: usize, at: usize) -> Option<Instant> {
        self.held[input].get(at).copied()
    }

    /// The time of the newest message that came, held or not.
    pub(super) fn newest(&self, input: usize) -> Option<Instant> {
        self.newest[input]
    }

    pub(super) fn counters(&self, input: usize) -> InputCounters {
        InputCounters {
            held: self.len(input) as u64,
            ..self.counters[input]
        }
    }

    /// Holds a message, unless its time is before that of an earlier one. Returns whether it is held.
    pub(super) fn push(&mut self, input: usize, time: Instant, min_period_ns: u64) -> bool {
        let counters = &mut self.counters[input];
        counters.received += 1;
        if let Some(newest) = self.newest[input] {
            if time < newest {
                counters.out_of_order += 1;
                self.outputs.push_back(Output::DropNewest(input));
                return false;
            }
            counters.too_soon += u64::from(time.0 - newest.0 < min_period_ns);
        }
        self.newest[input] = Some(time);
        self.held[input].push_back(time);
        true
    }

    pub(super) fn drop_oldest(&mut self, input: usize, reason: Unused) {
        if self.held[input].pop_front().is_some() {
            let counters = &mut self.counters[input];
            match reason {
                Unused::Unmatched => counters.unmatched += 1,
                Unused::Overflow => counters.overflow += 1,
            }
            self.outputs.push_back(Output::DropOldest(input));
        }
    }

    /// Makes a set of the oldest messages.
    pub(super) fn take_set(&mut self) {
        for (held, counters) in self.held.iter_mut().zip(&mut self.counters) {
            held.pop_front();
            counters.used += 1;
        }
        self.outputs.push_back(Output::Set);
    }

    pub(super) fn poll(&mut self) -> Option<Output> {
        self.outputs.pop_front()
    }

    /// The next output, which stays.
    pub(super) fn peek(&self) -> Option<Output> {
        self.outputs.front().copied()
    }

    /// Drops all messages, and forgets the times that have come.
    pub(super) fn clear(&mut self) {
        for input in 0..self.inputs() {
            while self.len(input) > 0 {
                self.drop_oldest(input, Unused::Unmatched);
            }
            self.newest[input] = None;
        }
    }
}
