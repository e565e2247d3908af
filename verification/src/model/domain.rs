//! The Manager and its nodes. Links are two ends that are open or closed; frames on links are not part of
//! this model.
//!
//! [`Scope`] defines the nodes and the possible events. [`World`] is one moment.

use std::hash::{DefaultHasher, Hash, Hasher};

mod action;
mod books;
mod choices;
mod compare;
mod faults;
mod hand;
mod kept;
#[path = "../../../sm2-proto/tests/support/matching.rs"]
mod matching;
mod mirror;
mod order;
mod policy;
mod ports;
mod print;
mod program;
mod quiet;
mod restriction;
mod room;
mod scope;
mod steps;
mod tape;
mod world;

pub use self::{
    action::Action,
    compare::Findings,
    hand::walk_by_hand,
    restriction::Restriction,
    scope::{Budget, Fault, Scope},
    world::World,
};
use super::{Failure, Golden, System};

/// The expected counts.
pub const COUNTS: Golden = Golden {
    file: "model-counts.txt",
    text: include_str!("../../model-counts.txt"),
};

impl System for Scope {
    type Moment = World;
    type Action = Action;

    fn first(&self) -> Result<World, Failure> {
        World::new(self)
    }

    fn actions(&self, world: &World) -> Vec<Action> {
        world.actions(self)
    }

    fn check(&self, world: &World, actions: &[Action]) -> Result<bool, Failure> {
        world.check(self, actions)
    }

    fn step(&self, world: &World, action: Action) -> Result<World, Failure> {
        world.step(self, action)
    }

    fn print(&self, world: &World) -> u64 {
        if self.reduced {
            world.print(self)
        } else {
            let mut hasher = DefaultHasher::new();
            world.hash(&mut hasher);
            hasher.finish()
        }
    }
}
