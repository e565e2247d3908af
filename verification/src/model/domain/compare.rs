//! Checks that reductions lose nothing: searches a scope with and without them.

use std::{cell::RefCell, collections::BTreeSet};

use super::{
    super::{Counterexample, Failure, Property, System, explore},
    Action, Scope, World,
};

/// The findings of a complete search.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Findings {
    /// The fingerprints of the quiet moments.
    pub quiet: BTreeSet<u64>,
    /// The properties that fail in some moment.
    pub failures: BTreeSet<Property>,
    /// The number of visited moments, which reductions change.
    pub states: usize,
}

impl Findings {
    /// Searches the whole scope, even beyond failures.
    ///
    /// # Errors
    ///
    /// A failure that ends the search: in the first moment, or a panic.
    pub fn of(scope: &Scope) -> Result<Self, Counterexample<Action>> {
        let collector = Collector {
            scope,
            found: RefCell::default(),
        };
        let report = explore(&collector, usize::MAX);
        let mut found = collector.found.into_inner();
        found.states = report.states;
        report.failure.map_or(Ok(found), Err)
    }

    /// True if two searches found the same quiet moments and failures.
    #[must_use]
    pub fn say_the_same(&self, other: &Self) -> bool {
        (&self.quiet, &self.failures) == (&other.quiet, &other.failures)
    }
}

/// A system that never fails: a moment when a property does not hold has no successors.
struct Collector<'a> {
    scope: &'a Scope,
    found: RefCell<Findings>,
}

impl System for Collector<'_> {
    type Moment = World;
    type Action = Action;

    fn first(&self) -> Result<World, Failure> {
        self.scope.first()
    }

    fn actions(&self, world: &World) -> Vec<Action> {
        self.scope.actions(world)
    }

    fn check(&self, world: &World, actions: &[Action]) -> Result<bool, Failure> {
        let checked = self.scope.check(world, actions);
        let mut found = self.found.borrow_mut();
        match checked {
            Ok(true) => {
                found.quiet.insert(world.print(self.scope));
            }
            Ok(false) => {}
            Err(failure) => {
                found.failures.insert(failure.property);
            }
        }
        Ok(false)
    }

    fn step(&self, world: &World, action: Action) -> Result<World, Failure> {
        self.scope.step(world, action).or_else(|failure| {
            let mut found = self.found.borrow_mut();
            found.failures.insert(failure.property);
            Ok(world.clone())
        })
    }

    fn print(&self, world: &World) -> u64 {
        self.scope.print(world)
    }
}
