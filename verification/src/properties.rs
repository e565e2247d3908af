//! PROPERTIES.md: what is claimed of the shipped code, what shows it, and how far that went.
//!
//! A [`Register`] is that file: a table of properties, and tables of checks, each with what it
//! covered when it was last run. A [`Session`] is what was run now; [`Session::gaps`] says where
//! the two disagree, [`Session::write`] brings the register up to date. `bin/check` runs the
//! engines; nothing here starts anything.

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
    judge::{Extent, Session},
    outcome::{Outcome, UnreadableOutcome, outcomes},
    proofs::{proofs, proofs_below},
    readme::{readme_table, with_table},
    register::{Check, Group, Property, Register, Run},
};
