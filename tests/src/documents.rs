//! The programs in README and in the book, compiled as doc tests.

#[doc = include_str!("../../README.md")]
mod readme {}

#[doc = include_str!("../../docs/src/getting-started.md")]
mod getting_started {}

#[doc = include_str!("../../docs/src/qos.md")]
mod qos {}

#[doc = include_str!("../../docs/src/testing.md")]
mod testing {}

#[doc = include_str!("../../docs/src/ros2-types.md")]
mod ros2_types {}

#[doc = include_str!("../../docs/src/tutorials/robot.md")]
mod robot {}
