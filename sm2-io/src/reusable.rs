//! A value that its owner writes, lends to any thread, and writes again once that thread has dropped it.
//!
//! An `Arc` that is cloned, dropped and made unique again needs three exchanges for each use. Only the return needs one
//! here: while nothing is lent, no other thread has access to the count. `verification/loom` runs this file, as it is,
//! through all executions that the memory model allows.

use std::fmt;
use std::marker::PhantomData;
use std::ops::Deref;
use std::ptr::NonNull;

use crate::sync::{AtomicU64, Exclusive, Ordering, fence};

/// The value, and how many ends hold it: the owner, the loan, or both.
struct Shared<T> {
    holders: AtomicU64,
    value: Exclusive<T>,
}

/// The owner's end of a value. At most one [`InUse`] of it exists at a time.
pub struct Reusable<T>(Held<T>);

/// The loan of a value, which nobody changes while this exists. It may outlive the owner's end.
pub struct InUse<T>(Held<T>);

/// One end: its drop frees the value if the other end is gone.
struct Held<T> {
    shared: NonNull<Shared<T>>,
    /// The drop check has to know that a value may be dropped here.
    owns: PhantomData<Shared<T>>,
}

// SAFETY: a shared value is read by both ends, so by two threads, and is dropped by either.
#[allow(unsafe_code, reason = "see the SAFETY text")]
unsafe impl<T: Send + Sync> Send for Held<T> {}
// SAFETY: a reference to an end gives references to the value alone.
#[allow(unsafe_code, reason = "see the SAFETY text")]
unsafe impl<T: Send + Sync> Sync for Held<T> {}

impl<T> Reusable<T> {
    /// Makes a value, which is not lent.
    #[must_use]
    pub fn new(value: T) -> Self {
        let shared = Box::new(Shared {
            holders: AtomicU64::new(1),
            value: Exclusive::new(value),
        });
        Self(Held {
            shared: NonNull::from(Box::leak(shared)),
            owns: PhantomData,
        })
    }

    /// Changes the value by `change`, and lends it. `None`, without a call of `change`, while the value is lent.
    #[inline]
    pub fn lend(&mut self, change: impl FnOnce(&mut T)) -> Option<InUse<T>> {
        let shared = self.0.shared();
        // Pairs with the release of a loan that is dropped: it has read the value before.
        if shared.holders.load(Ordering::Acquire) != 1 {
            return None;
        }
        // SAFETY: the only holder is this end, which is borrowed mutably. `InUse`s are made here alone.
        #[allow(unsafe_code, reason = "see the SAFETY text")]
        unsafe {
            shared.value.change(change);
        }
        // Relaxed, and no exchange: no other thread has access to the count before it gets the loan, and what gives it
        // to another thread orders this.
        shared.holders.store(2, Ordering::Relaxed);
        Some(InUse(Held {
            shared: self.0.shared,
            owns: PhantomData,
        }))
    }
}

impl<T> Held<T> {
    #[inline]
    fn shared(&self) -> &Shared<T> {
        // SAFETY: it was allocated in `Reusable::new`, and this end is counted, so it is not freed.
        #[allow(unsafe_code, reason = "see the SAFETY text")]
        unsafe {
            self.shared.as_ref()
        }
    }

    #[cold]
    fn free(&mut self) {
        // SAFETY: `Reusable::new` leaked this box, and the last end is being dropped.
        #[allow(unsafe_code, reason = "see the SAFETY text")]
        drop(unsafe { Box::from_raw(self.shared.as_ptr()) });
    }
}

impl<T> Drop for Held<T> {
    #[inline]
    fn drop(&mut self) {
        if self.shared().holders.fetch_sub(1, Ordering::Release) == 1 {
            // The end that was dropped before has read the value, or has written it.
            fence(Ordering::Acquire);
            self.free();
        }
    }
}

impl<T> Deref for InUse<T> {
    type Target = T;

    #[inline]
    fn deref(&self) -> &T {
        // SAFETY: the owner writes the value only while it is the only holder.
        #[allow(unsafe_code, reason = "see the SAFETY text")]
        unsafe {
            self.0.shared().value.get()
        }
    }
}

impl<T> fmt::Debug for Reusable<T> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        // Not the value, which may be lent.
        f.debug_struct("Reusable").finish_non_exhaustive()
    }
}

impl<T: fmt::Debug> fmt::Debug for InUse<T> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_tuple("InUse").field(&**self).finish()
    }
}
