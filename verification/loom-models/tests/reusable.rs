//! A value that is lent and used again: nobody writes it while another thread reads it.
//!
//! The code is `sm2-io/src/reusable.rs`.

// Each variant has the same scenarios.
#![allow(clippy::duplicate_mod)]

use sm2_loom_models::{fails, holds};

/// Replaces `sm2-io/src/sync.rs`.
mod sync {
    use loom::cell::UnsafeCell;
    pub(crate) use loom::sync::atomic::{AtomicU64, Ordering, fence};

    pub(crate) struct Exclusive<T>(UnsafeCell<T>);

    impl<T> Exclusive<T> {
        pub(crate) fn new(value: T) -> Self {
            Self(UnsafeCell::new(value))
        }

        /// # Safety
        ///
        /// Loom fails if somebody else uses the value meanwhile.
        pub(crate) unsafe fn change<R>(&self, change: impl FnOnce(&mut T) -> R) -> R {
            self.0.with_mut(|it| change(unsafe { &mut *it }))
        }

        /// # Safety
        ///
        /// Loom fails if somebody changes the value meanwhile.
        pub(crate) unsafe fn get(&self) -> &T {
            self.0.with(|it| unsafe { &*it })
        }
    }
}

include!(concat!(env!("OUT_DIR"), "/reusable.rs"));

/// The message of loom about two accesses that nothing orders.
const RACE: &str = "Causality violation";

#[test]
fn nobody_writes_a_value_that_is_lent() {
    use shipped::scenarios::{again, ends};
    // Shows RNG-CELL (loom), bound: two loans; no limit of preemptions.
    holds("reusable: lent, and lent again", None, again);
    // Shows RNG-CELL (loom), bound: one loan; no limit of preemptions.
    holds("reusable: both ends are dropped", None, ends);
}

#[test]
fn each_part_of_it_is_needed() {
    macro_rules! fail {
        ($($variant:ident: $scenario:ident)*) => {
            $(fails(
                concat!("reusable: ", stringify!($variant)),
                None,
                RACE,
                $variant::scenarios::$scenario,
            );)*
        };
    }
    fail!(lent_without_acquire: again returned_without_release: again lent_twice: again);
    fail!(freed_without_acquire: ends);
}
