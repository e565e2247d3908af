//! The inputs of members, and their answers.

/// The domain time between two inputs, and the period of the timer.
pub(super) const INPUT_NS: u64 = 3;
pub(super) const TICK_NS: u64 = 2;

/// The kinds of inputs, in the order of their topics; ticks come last.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub(super) enum Kind {
    Detection,
    Input,
    Result,
    Tick,
}

impl Kind {
    pub(super) const fn is_for(self, member: usize) -> bool {
        match self {
            Self::Input => true,
            Self::Detection => member > 0,
            Self::Result => member == 2,
            Self::Tick => member == 1,
        }
    }

    /// The message that a member publishes when it handles such an input.
    pub(super) const fn answer(self, member: usize) -> Option<Self> {
        match (member, self) {
            (0, Self::Input) => Some(Self::Detection),
            (1, Self::Detection | Self::Tick) => Some(Self::Result),
            _ => None,
        }
    }
}

/// An input that a member has handled.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(super) struct Handled {
    pub(super) step: u64,
    pub(super) round: u64,
    pub(super) kind: Kind,
}
