//! Explanations of a domain for people: why two interfaces are linked or not, which counterparts of an interface may
//! have been meant, where two schemas differ, and how much of each quota is used.
//!
//! | to do | call |
//! | --- | --- |
//! | explain a pair | [`why`] |
//! | explain an interface without links | [`nearest`] |
//! | compare two schemas | [`difference`] |
//! | compare usage with quotas | [`users`], [`processes`], [`sessions`] |
//!
//! The functions are pure: they look at a [`Domain`](crate::domain::Domain), which holds the items that a Manager sent.
//! An item may name nodes that the domain does not show. All functions then answer without them; none panics.

mod difference;
#[cfg(feature = "fuzzing")]
pub(crate) mod fuzz;
mod names;
mod near;
mod text;
mod usage;
mod verdict;
mod why;

pub use self::{
    difference::{Difference, difference},
    names::NearName,
    near::{NEAR_MAX, Near, nearest},
    usage::{ProcessUsage, SessionUsage, UserUsage, processes, sessions, users},
    verdict::{Finding, Part, Party, Reliability, Seal, TypePair, Verdict},
    why::why,
};
