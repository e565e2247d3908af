//! Runs the shipped machines through every order of events within bounds.
//!
//! A [`System`] defines the actions that are possible in a moment. [`explore`] visits every reachable
//! moment, breadth first, and checks each [`Property`] in it. [`domain`] models the Manager with its
//! nodes, [`link`] the two ends of one link, and [`lockstep`] a conductor with its members.

pub mod command;
pub mod domain;
mod explorer;
mod golden;
pub mod link;
pub mod lockstep;
mod properties;

use self::properties::fail;
pub use self::{
    explorer::{Counterexample, Progress, Report, System, explore, explore_telling},
    golden::Golden,
    properties::{Failure, Property},
};
