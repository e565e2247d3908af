//! The integration tests of the Manager.
//!
//! One program: its tests share one build and one link.

mod common;

mod access;
mod activation;
mod counters;
mod hand_over;
mod limits;
mod own_loop;
mod policy_file;
mod program;
mod reload;
mod shortage;
mod standby;
mod units;
