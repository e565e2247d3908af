//! The bounds of a search: the members, and the events that may happen.

/// A deliberate fault, which the search must find. It happens whenever it is possible.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Fault {
    /// The conductor reads the clock before the round before has ended.
    CutEarly,
    /// A member handles every message that is there, also those published after the cut.
    IgnoresCut,
    /// A member calls before it has handled all its inputs.
    FinishesEarly,
    /// A member counts no message as taken.
    TakenIsZero,
    /// The conductor does not learn that a member is gone.
    EndUnseen,
    /// A turn arrives twice.
    TurnTwice,
}

/// The bounds of one search.
#[derive(Clone, Debug)]
pub struct LockstepScope {
    /// The name.
    pub name: &'static str,
    /// The number of members: the first ones of detector, filter and logger.
    pub members: usize,
    /// The number of steps with an input.
    pub inputs: u8,
    /// Whether the filter has a timer. Its ticks add steps between the inputs.
    pub timer: bool,
    /// How many members die.
    pub deaths: u8,
    /// How many members join after the first step has begun. A node that died may join again.
    pub joins: u8,
    /// The fault, if any.
    pub fault: Option<Fault>,
}

impl LockstepScope {
    /// All scopes.
    #[must_use]
    pub fn all() -> Vec<Self> {
        let scope = |name, members, inputs| Self {
            name,
            members,
            inputs,
            timer: false,
            deaths: 0,
            joins: 0,
            fault: None,
        };
        vec![
            // Shows lockstep (model), bound: detector and filter; 3 inputs.
            scope("lockstep-2", 2, 3),
            // Shows lockstep (model), bound: detector, filter and logger; 2 inputs.
            scope("lockstep-3", 3, 2),
            // Shows lockstep (model), bound: as lockstep-3, with a timer of the filter.
            Self {
                timer: true,
                ..scope("lockstep-timer", 3, 2)
            },
            // Shows lockstep (model), bound: as lockstep-3; 2 deaths after the first step has begun.
            Self {
                deaths: 2,
                ..scope("lockstep-deaths", 3, 2)
            },
            // Shows lockstep (model), bound: as lockstep-timer; a death and a join after the first step has begun.
            Self {
                deaths: 1,
                joins: 1,
                timer: true,
                ..scope("lockstep-joins", 3, 2)
            },
        ]
    }

    /// The scope of this name.
    #[must_use]
    pub fn named(name: &str) -> Option<Self> {
        Self::all().into_iter().find(|it| it.name == name)
    }
}
