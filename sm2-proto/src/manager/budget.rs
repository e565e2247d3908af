//! The cost of work, counted in units.
//!
//! One frame can affect thousands of links, so the machine counts its work in units, and stops when the budget of a
//! part is used up (SM2-SES-009). Each `Tick` then does one more part, of the session that has used least. The place
//! where the work continues is part of the machine's state, so models explore it. The further frames of a busy session
//! wait in its socket: the machine queues nothing, and their order is kept. An interface that is gone leaves the
//! machine's tables with the first part; only its links remain, in `EndingLinks`, until the other ends are told.

use crate::control::{Limit, Limits};

/// The cost of comparing two contracts, which is the unit.
pub(super) const PAIR: usize = 1;
/// The cost of noting or forgetting why a pair is not linked.
pub(super) const MARK: usize = 4;
/// The cost of ending a link or claim, with its UNLINK.
pub(super) const UNLINK: usize = 16;
/// The cost of making or announcing a link, with its socket pair and its two LINKs.
pub(super) const LINK: usize = 64;

/// The work that may still be done in this part.
#[derive(Debug)]
pub(super) struct Budget(usize);

impl Budget {
    pub(super) const fn new(limits: &Limits) -> Self {
        Self(limits.count(Limit::WorkPerTurn))
    }

    /// The budget of the first part of a DECLARE. It is four times as large, because DECLARED counts
    /// the links of this part: a publisher waits for them before its first message.
    pub(super) const fn of_declare(limits: &Limits) -> Self {
        Self(limits.count(Limit::WorkPerTurn).saturating_mul(4))
    }

    pub(super) const fn unlimited() -> Self {
        Self(usize::MAX)
    }

    /// Notes that work is done. The last piece of work may exceed the budget.
    pub(super) const fn spend(&mut self, cost: usize) {
        self.0 = self.0.saturating_sub(cost);
    }

    /// The units that are left.
    pub(super) const fn left(&self) -> usize {
        self.0
    }

    pub(super) const fn is_spent(&self) -> bool {
        self.0 == 0
    }
}
