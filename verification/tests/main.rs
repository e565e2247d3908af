//! The tests of the checks.
//!
//! One program: its tests share one build and one link.

mod clauses;
mod link_model;
mod lockstep_model;
mod model;
mod mutants;
mod properties;
mod walk;
