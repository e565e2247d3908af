//! Checks of SM2 that are not tests of one crate.
//!
//! Today this is [`clauses`]: SPEC.md, the code and the checks must name the
//! same clauses. It is no part of the product: no other crate depends on it,
//! and the CI script calls its binaries. `README.md` beside this crate says
//! what else is checked, where, and what is still to come.

pub mod clauses;
pub mod model;
