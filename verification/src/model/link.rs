//! One link. Both ends are the shipped machines, with two queues of frames between them. Each end has a
//! driver and an application that follow the contract of [`sm2_proto::link`].
//!
//! [`LinkScope`] defines the link and the possible events. [`World`] is one moment. Plain lists beside the
//! machines give the expected behaviour.

mod action;
mod application;
mod books;
mod driver;
mod pool;
mod quiet;
mod scope;
mod wire;
mod world;

pub use self::{
    action::Action,
    scope::{Budget, Fault, Form, LinkKind, LinkScope, Start},
    world::World,
};
use super::{Failure, Golden, Property, System, command::Scope};

/// The expected counts.
pub const COUNTS: Golden = Golden {
    file: "link-model-counts.txt",
    text: include_str!("../../link-model-counts.txt"),
};

impl System for LinkScope {
    type Moment = World;
    type Action = Action;

    fn first(&self) -> Result<World, Failure> {
        let mut world = World::new(self);
        while self.start == Start::Opened
            && let Some(action) = world.actions(self).into_iter().find(|it| it.goes_on())
        {
            world = world.step(self, action)?;
        }
        Ok(world)
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
}

impl Scope for LinkScope {
    const COUNTS: Golden = COUNTS;

    fn all() -> Vec<Self> {
        Self::all()
    }

    fn name(&self) -> &'static str {
        self.name
    }

    fn is_quick(&self) -> bool {
        self.quick
    }
}

fn fail<T>(property: Property, what: impl Into<String>) -> Result<T, Failure> {
    Err(Failure {
        property,
        what: what.into(),
    })
}
