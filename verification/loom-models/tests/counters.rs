//! The seqlock of the counters: a reader never accepts a mix of two changes.
//!
//! The code is `sm2-io/src/counters/seqlock.rs`; processes are modelled as threads.

// Each variant has the same scenarios.
#![allow(clippy::duplicate_mod)]

use sm2_loom_models::{fails, holds};

/// Replaces `sm2-io/src/sync.rs`.
mod sync {
    pub(crate) use loom::sync::atomic::{AtomicU64, Ordering, fence};
}

include!(concat!(env!("OUT_DIR"), "/counters.rs"));

const MIX: &str = "a mix of two writings";

//= SM2-CNT-006 loom
#[test]
fn a_reader_never_takes_a_mix() {
    use shipped::scenarios::{changes, readers, reuse, stopped};
    // Shows CNT-WHOLE (loom), bound: three words of 64; 3 preemptions.
    holds("counters: two changes, two looks", Some(3), changes);
    // Shows CNT-WHOLE (loom), bound: three words of 64; 2 preemptions.
    holds("counters: two readers", Some(2), readers);
    // Shows CNT-WHOLE (loom), bound: three words of 64; 3 preemptions.
    holds("counters: freed and used again", Some(3), reuse);
    // Shows CNT-WHOLE (loom), bound: three words of 64; 3 preemptions.
    holds("counters: a writer that was stopped", Some(3), stopped);
}

//= SM2-CNT-006 loom
#[test]
fn each_part_of_it_is_needed() {
    macro_rules! fail {
        ($($variant:ident)*) => {
            $(fails(
                concat!("counters: ", stringify!($variant)),
                Some(3),
                MIX,
                $variant::scenarios::changes,
            );)*
        };
    }
    fail!(no_release_fence relaxed_end no_odd_turn odd_taken);
    fail!(no_second_look no_first_acquire no_second_acquire);
    let anew = shipped::scenarios::turns_begin_anew;
    fails("counters: turns begin anew", Some(3), MIX, anew);
}
