//! The integration tests of the generator.
//!
//! One program: its tests share one build and one link.

mod builder;
mod common;
mod errors;
mod layout;
mod names;
mod size;
mod values;
