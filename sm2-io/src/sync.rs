//! The atomics of this crate: clippy rejects them everywhere else (`clippy.toml`).
//!
//! `verification/loom` puts the atomics of loom in their place, and runs the same code through
//! executions that the memory model allows.

use std::cell::UnsafeCell;
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

/// A value that the owner of this cell may change although others share it.
#[derive(Debug)]
pub(crate) struct Exclusive<T>(UnsafeCell<T>);

impl<T> Exclusive<T> {
    pub(crate) const fn new(value: T) -> Self {
        Self(UnsafeCell::new(value))
    }

    /// # Safety
    ///
    /// Nobody else uses the value meanwhile.
    #[allow(unsafe_code, reason = "passes the condition on")]
    #[inline]
    pub(crate) unsafe fn change<R>(&self, change: impl FnOnce(&mut T) -> R) -> R {
        // SAFETY: the caller promises it.
        change(unsafe { &mut *self.0.get() })
    }

    /// # Safety
    ///
    /// Nobody changes the value while the result lives.
    #[allow(unsafe_code, reason = "passes the condition on")]
    #[inline]
    pub(crate) unsafe fn get(&self) -> &T {
        // SAFETY: the caller promises it.
        unsafe { &*self.0.get() }
    }
}
