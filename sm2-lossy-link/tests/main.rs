//! The integration tests of the emulated links.
//!
//! One program: its tests share one build and one link.

mod namespaces;
mod numbered;
mod relay;
