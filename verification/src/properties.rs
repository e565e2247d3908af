//! PROPERTIES.md: claims about the shipped code, the checks that show them, and their coverage.
//!
//! A [`Register`] is the parsed file: a table of properties, and tables of checks with the coverage of
//! their last run. A [`RunResults`] has the results of a run. [`RunResults::gaps`] lists the disagreements of
//! both, and [`RunResults::write`] updates the register. This module starts no programs: `bin/check` runs
//! the engines.

mod engine;
mod figures;
mod gap;
mod judge;
mod outcome;
mod proofs;
mod readme;
mod register;
mod table;

pub use self::{
    engine::Engine,
    figures::same_figures,
    gap::{Gap, GapKind},
    judge::{Extent, RunResults},
    outcome::{Outcome, UnreadableOutcome, outcomes},
    proofs::{proofs, proofs_below},
    readme::{readme_table, with_table},
    register::{Check, Group, Property, Register, Run},
};
