//! PROPERTIES.md: claims about the shipped code, the checks that show them, and their coverage.
//!
//! A [`Register`] is the parsed file with the checks, which sources and lists beside the engines name ([`Listed`]). A
//! [`RunResults`] has the results of a run, and [`RunResults::gaps`] lists the disagreements of both. [`figures_page`]
//! shows the figures of a run, which are not committed. This module starts no programs: `bin/check` runs the engines.

mod check;
mod claims;
mod engine;
mod expected;
mod figures;
mod gap;
mod judge;
mod listed;
mod outcome;
mod proofs;
mod register;
mod summary;
mod table;

pub use self::{
    check::{Check, Run},
    claims::{Place, checks_of},
    engine::Engine,
    expected::{tests_in, tests_of},
    figures::figures_page,
    gap::{Gap, GapKind},
    judge::{Extent, RunResults},
    listed::{Listed, loom_models},
    outcome::{Outcome, UnreadableOutcome, outcomes},
    proofs::{Proof, proofs, proofs_below},
    register::{Group, Property, Register},
    summary::summary,
};
