//! Gateways.
pub mod clock;
pub mod peer;
