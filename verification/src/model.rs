//! The shipped Manager and nodes together, in every order of events within bounds.
//!
//! [`Scope`] says who is there and what may happen, [`World`] is one moment of it, [`explore`]
//! visits every moment that can be reached, shortest ways first, and checks each
//! [`Property`] in it. Links are two ends that are open or closed; what flows on them is no part
//! of this model.

mod action;
mod explorer;
mod ports;
mod properties;
mod quiet;
mod scope;
mod world;

pub use self::{
    action::Action,
    explorer::{Counterexample, Report, explore},
    properties::{Failure, Property},
    scope::{Budget, Fault, Scope},
    world::World,
};
