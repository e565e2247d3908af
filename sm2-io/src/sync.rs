//! The atomics of this crate: clippy rejects them from anywhere else (`clippy.toml`).
//!
//! `verification/loom` puts the ones of loom in their place, and runs the same code through
//! executions that the memory model allows.

#[allow(
    clippy::disallowed_types,
    reason = "the one place that imports atomics"
)]
pub(crate) use std::sync::atomic::AtomicU64;
pub(crate) use std::sync::atomic::{Ordering, compiler_fence, fence};
