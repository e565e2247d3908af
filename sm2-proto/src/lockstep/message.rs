//! The messages of the service `lockstep`.

use crate::{Instant, clock::DomainTime};

/// A member's call: it has finished a turn, or joins.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct Done {
    /// The step of the turn; 0 in a join.
    pub step: u64,
    /// The round of the turn; 0 in a join.
    pub round: u64,
    /// The number of messages and of ticks that the member handled in the turn.
    pub taken: u64,
    /// The time when the member's next timer is due; `None` if it has none, and in a join.
    pub next: Option<DomainTime>,
}

impl Done {
    /// The first call of a member.
    pub const JOIN: Self = Self {
        step: 0,
        round: 0,
        taken: 0,
        next: None,
    };

    /// Whether the call is a join.
    #[must_use]
    pub const fn is_join(&self) -> bool {
        self.step == 0
    }
}

/// The conductor's reply: the member handles its inputs.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct Turn {
    /// The number of the step, from 1.
    pub step: u64,
    /// The number of the round in the step, from 0.
    pub round: u64,
    /// The domain time of the step.
    pub time: DomainTime,
    /// Messages that were published until this moment belong to the turn.
    pub cut: Instant,
}
