//! Options of a synchronizer.

use std::fmt;
use std::time::Duration;

use super::approximate::Options;
use super::core::Core;
use super::sets::Synchronizer;
use super::tuples::{InputTuple, Slots};
use crate::DeclareError;

/// The longest queue of an input, in messages: the program may hold 1,024 messages of a publisher (SM2-QOS-001).
/// One of these has just been taken, and one belongs to the set in the hand of the program.
pub const QUEUE_MAX: u16 = 1_022;

/// Options of a [`Synchronizer`].
#[must_use = "a builder does nothing until declare is called"]
pub struct SynchronizerBuilder<I> {
    inputs: I,
    queue: u16,
    sets_held: u16,
    policy: Policy,
}

enum Policy {
    Exact,
    Approximate {
        max_interval: Duration,
        age_penalty_percent: u32,
    },
}

impl Synchronizer<()> {
    /// Synchronizes topics by equal times: see [above](Self#exact-times).
    pub const fn exact<I: InputTuple>(inputs: I) -> SynchronizerBuilder<I> {
        SynchronizerBuilder::new(inputs, Policy::Exact)
    }

    /// Synchronizes topics by similar times: see [above](Self#approximate-times).
    pub const fn approximate<I: InputTuple>(inputs: I) -> SynchronizerBuilder<I> {
        let policy = Policy::Approximate {
            max_interval: Duration::MAX,
            age_penalty_percent: 10,
        };
        SynchronizerBuilder::new(inputs, policy)
    }
}

impl<I: InputTuple> SynchronizerBuilder<I> {
    const fn new(inputs: I, policy: Policy) -> Self {
        Self {
            inputs,
            queue: 8,
            sets_held: 1,
            policy,
        }
    }

    /// Sets how many messages of each input wait for the messages that belong to them: 1 to [`QUEUE_MAX`]; 8 by
    /// default, and 0 counts as 1. One more drops the oldest, which counts as an
    /// [`overflow`](super::InputCounters::overflow).
    ///
    /// Choose at least as many as the fastest input has within the longest delay between the inputs. Each message that
    /// waits occupies memory of its publisher.
    pub const fn queue(mut self, messages: u16) -> Self {
        self.queue = messages;
        self
    }

    /// Sets how many sets the program holds at a time, as far as the synchronizer knows; 1 by default. Declares
    /// subscribers that may hold so many messages more.
    pub const fn sets_held(mut self, sets: u16) -> Self {
        self.sets_held = sets;
        self
    }

    /// Sets the longest time between the messages of a set; no limit by default. Only approximate synchronizers use it.
    pub const fn max_interval(mut self, interval: Duration) -> Self {
        if let Policy::Approximate { max_interval, .. } = &mut self.policy {
            *max_interval = interval;
        }
        self
    }

    /// Sets by how much a later set has to be better than an earlier one, in percent; 10 by default. With 0, each set
    /// is the shortest one, however long it has to be waited for. Only approximate synchronizers use it.
    pub const fn age_penalty_percent(mut self, percent: u32) -> Self {
        if let Policy::Approximate {
            age_penalty_percent,
            ..
        } = &mut self.policy
        {
            *age_penalty_percent = percent;
        }
        self
    }

    /// Declares the subscribers, and waits for the Manager's answers.
    ///
    /// Each subscriber may hold the messages that wait, one that has just been taken, and those of the sets that the
    /// program [holds](Self::sets_held), or more if its own [`max_borrowed`] is greater.
    ///
    /// [`max_borrowed`]: crate::SubscriberBuilder::max_borrowed
    ///
    /// # Errors
    ///
    /// See [`DeclareError`]. A queue that is too long, with the sets held, is the error [`DeclareError::Qos`] of the
    /// subscribers' `max_borrowed`.
    pub fn declare(self) -> Result<Synchronizer<I::Set>, DeclareError> {
        let queue = self.queue.max(1);
        let held = queue.saturating_add(1).saturating_add(self.sets_held);
        let slots = self.inputs.declare(held)?;
        let core = self.policy.core(&slots, usize::from(queue));
        Ok(Synchronizer::new(slots, core))
    }
}

impl Policy {
    fn core<S>(&self, slots: &Slots<S>, queue_max: usize) -> Core {
        match *self {
            Self::Exact => Core::exact(slots.iter().count(), queue_max),
            Self::Approximate {
                max_interval,
                age_penalty_percent,
            } => {
                let options = Options {
                    max_interval_ns: nanoseconds(max_interval),
                    age_penalty_percent,
                    min_periods_ns: slots
                        .iter()
                        .map(|it| nanoseconds(it.min_period()))
                        .collect(),
                };
                Core::approximate(options, queue_max)
            }
        }
    }
}

impl<I> fmt::Debug for SynchronizerBuilder<I> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("SynchronizerBuilder")
            .field("queue", &self.queue)
            .field("sets_held", &self.sets_held)
            .finish_non_exhaustive()
    }
}

fn nanoseconds(duration: Duration) -> u64 {
    u64::try_from(duration.as_nanos()).unwrap_or(u64::MAX)
}
