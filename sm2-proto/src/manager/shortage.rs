//! A shortage of descriptors or memory: the driver could not make the socket pair of a link
//! (SM2-LNK-008), or a node could not use its end (SM2-LNK-009).
//!
//! A receiver that lost a descriptor ends the link with the code `resources`. The other side sees the end of the
//! stream, and may report `peer-gone` first, so the Manager remembers the pair until both sides have said farewell.

use core::time::Duration;

use super::{links::Pair, unlinked::UnlinkedPairs};
use crate::{EntityId, Instant, control::UnlinkedReason};

/// The delay after the first failure.
const FIRST: Duration = Duration::from_millis(10);
/// The longest delay.
const LONGEST: Duration = Duration::from_secs(1);

/// The pairs whose links could not be made or kept, and the time of the next attempt.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub(super) struct Shortage {
    pairs: UnlinkedPairs,
    attempt: Option<Attempt>,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
struct Attempt {
    at: Instant,
    /// The delay before the attempt.
    delay: Duration,
}

impl Shortage {
    pub(super) const fn new() -> Self {
        Self {
            pairs: UnlinkedPairs::new(),
            attempt: None,
        }
    }

    /// Notes that a link could not be made or kept. Failures of one attempt count once. Each attempt that
    /// fails doubles the delay.
    //= SM2-LNK-008, SM2-LNK-009
    pub(super) fn failed(&mut self, pair: Pair, now: Instant) {
        self.pairs
            .insert(pair, UnlinkedReason::Descriptors, usize::MAX);
        let delay = match self.attempt {
            Some(next) if now < next.at => return,
            Some(last) => LONGEST.min(last.delay.saturating_mul(2)),
            None => FIRST,
        };
        let at = now.after(delay);
        self.attempt = Some(Attempt { at, delay });
    }

    /// The time of the next attempt.
    pub(super) fn deadline(&self) -> Option<Instant> {
        let attempt = self.attempt.filter(|_| self.pairs.iter().next().is_some());
        attempt.map(|it| it.at)
    }

    /// Whether the next attempt may be made now.
    pub(super) fn is_due(&self, now: Instant) -> bool {
        self.deadline().is_some_and(|at| at <= now)
    }

    /// Takes out a pair for the next attempt.
    pub(super) fn pop(&mut self) -> Option<Pair> {
        let pair = self.pairs.iter().next()?;
        self.pairs.remove(pair);
        Some(pair)
    }

    /// Forgets the last delay once attempts were possible for as long, and none has failed. An
    /// attempt that is still to be made stays, however late it is.
    pub(super) fn expire(&mut self, now: Instant) {
        if self.deadline().is_none() {
            self.attempt = self.attempt.filter(|it| now < it.at.after(it.delay));
        }
    }

    /// Forgets one pair of an interface that is gone or suspended. Returns whether there was one.
    pub(super) fn forget_one(&mut self, entity: EntityId) -> bool {
        let pair = self.pairs.first_of(entity);
        pair.is_some_and(|it| self.pairs.remove(it))
    }

    pub(super) fn remove(&mut self, pair: Pair) {
        self.pairs.remove(pair);
    }

    pub(super) fn pairs(&self) -> impl Iterator<Item = Pair> {
        self.pairs.iter()
    }
}
