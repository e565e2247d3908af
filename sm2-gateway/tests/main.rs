//! The integration tests of the gateway.
//!
//! One program: its tests share one build and one link.

mod common;

mod age;
mod beacons;
mod beside;
mod config;
#[cfg(feature = "program")]
mod descriptors;
mod domains;
mod duplicates;
mod hostile_peers;
mod hub;
mod idle_peer;
#[cfg(feature = "program")]
mod killed;
#[cfg(feature = "metrics")]
mod metrics;
mod offers;
#[cfg(feature = "program")]
mod reports;
mod rules;
mod shortage;
mod simulation;
mod stuck_link;
mod traffic;
#[cfg(feature = "program")]
mod units;
