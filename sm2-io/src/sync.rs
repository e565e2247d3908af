//! The atomics of this crate: clippy rejects them everywhere else (`clippy.toml`).
//!
//! `verification/loom` puts the atomics of loom in their place, and runs the same code through
//! executions that the memory model allows.

use std::sync::atomic;

pub(crate) use std::sync::atomic::{Ordering, compiler_fence};

// An alias, because the lint follows imports to the type that they name.
#[allow(
    clippy::disallowed_types,
    reason = "the one place of this crate that names an atomic"
)]
pub(crate) type AtomicU64 = std::sync::atomic::AtomicU64;

/// A fence. One that is sequentially consistent has to follow an exchange by the same thread, with no other access to
/// shared memory in between that it has to order.
#[inline]
pub(crate) fn fence(ordering: Ordering) {
    // On x86-64, an exchange is an instruction with a lock, which no later load passes. So nothing is left to do but to
    // keep the compiler from moving loads.
    match cfg!(all(target_arch = "x86_64", not(miri))) && matches!(ordering, Ordering::SeqCst) {
        true => compiler_fence(ordering),
        false => atomic::fence(ordering),
    }
}
