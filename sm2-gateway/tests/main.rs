//! The integration tests of the gateway.
//!
//! One program: its tests share one build and one link.

mod common;

mod age;
mod bad_link;
mod beside;
mod config;
mod domains;
mod duplicates;
mod hostile_peers;
mod hub;
mod metrics;
mod offers;
mod rules;
mod shortage;
mod silence;
mod simulation;
mod stuck_link;
mod units;
