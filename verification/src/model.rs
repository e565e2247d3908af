//! The shipped machines in every order of events within bounds.
//!
//! A [`System`] says what can happen at any moment; [`explore`] visits every moment that can be
//! reached, shortest ways first, and checks each [`Property`] in it. [`domain`] is the Manager
//! with its nodes, [`link`] the two ends of one link.

pub mod domain;
mod explorer;
mod golden;
pub mod link;
mod properties;

pub use self::{
    explorer::{Counterexample, Progress, Report, System, explore, explore_telling},
    golden::Golden,
    properties::{Failure, Property},
};
