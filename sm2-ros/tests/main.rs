//! The integration tests of ROS 2's types.
//!
//! One program: its tests share one build and one link.

mod cdr;
#[cfg(feature = "fuzzing")]
mod fuzz_corpus;
#[cfg(all(feature = "common-interfaces", feature = "messages"))]
mod nodes;
mod place;
#[cfg(feature = "common-interfaces")]
mod types;
mod values;
#[cfg(feature = "common-interfaces")]
mod views;
