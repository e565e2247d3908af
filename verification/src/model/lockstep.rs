//! A lockstep. The conductor and its members are the shipped machines. Calls and turns are in flight between them until
//! an action delivers them, and messages are in the queues of their subscribers as soon as they are published.
//!
//! The members are a detector, a filter and a logger, in this order. In each step the conductor publishes one input.
//!
//! | member | handles | publishes |
//! | --- | --- | --- |
//! | detector | inputs | a detection of each input |
//! | filter | inputs, detections, a timer if the scope has one | a result of each detection and of each tick |
//! | logger | inputs, detections, results | nothing |

mod expected;
mod inputs;
mod scope;
mod world;

pub use self::{
    scope::{Fault, LockstepScope},
    world::{Action, World},
};
use super::{Failure, Golden, System, command::Scope};

/// The expected counts.
pub const COUNTS: Golden = Golden {
    file: "lockstep-model-counts.txt",
    text: include_str!("../../lockstep-model-counts.txt"),
};

impl System for LockstepScope {
    type Moment = World;
    type Action = Action;

    fn first(&self) -> Result<World, Failure> {
        Ok(World::new(self))
    }

    fn actions(&self, world: &World) -> Vec<Action> {
        world.actions(self)
    }

    fn check(&self, world: &World, actions: &[Action]) -> Result<bool, Failure> {
        world.check(self, actions)
    }

    fn step(&self, world: &World, action: Action) -> Result<World, Failure> {
        let mut next = world.clone();
        next.act(self, action)?;
        Ok(next)
    }
}

impl Scope for LockstepScope {
    const COUNTS: Golden = COUNTS;

    fn all() -> Vec<Self> {
        Self::all()
    }

    fn name(&self) -> &'static str {
        self.name
    }

    fn is_quick(&self) -> bool {
        true
    }
}
