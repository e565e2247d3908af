//! The atomics of this crate: clippy rejects them everywhere else (`clippy.toml`).
//!
//! `verification/loom` puts the atomics of loom in their place, and runs the same code through
//! executions that the memory model allows.

pub(crate) use std::sync::atomic::{Ordering, compiler_fence, fence};

// An alias, because the lint follows imports to the type that they name.
#[allow(
    clippy::disallowed_types,
    reason = "the one place of this crate that names an atomic"
)]
pub(crate) type AtomicU64 = std::sync::atomic::AtomicU64;
