//! The tests of the gateway that take long: `.ci/full` runs them.

mod bad_link;
mod common;
mod traffic;
