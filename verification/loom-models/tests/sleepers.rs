//! Threads that wait at an interface or for the session. A thread that does something for another one wakes that
//! thread: it receives a message for it, hands a link over to it, or changes the session.
//!
//! The code is `sleepers.rs`, `sleep.rs`, `wait.rs`, `bell.rs` and `watch.rs` of `sm2-node/src/driver/`; `kernel`
//! models the system calls that it makes. A lost wake-up leaves a thread asleep for ever, which loom reports as
//! a deadlock.

// Each variant has the same scenarios.
#![allow(clippy::duplicate_mod)]

use sm2_loom_models::{fails, holds};

#[path = "sleepers/kernel.rs"]
mod kernel;

/// As in `sm2-node/src/wait.rs`.
#[derive(Clone, Copy)]
#[allow(dead_code, reason = "nobody spins here: no time passes")]
enum Wait {
    Park,
    SpinThenPark(std::time::Duration),
    Spin,
}

include!(concat!(env!("OUT_DIR"), "/sleepers.rs"));

const LOST: &str = "deadlock";

#[test]
fn no_wake_up_is_lost() {
    use shipped::scenarios::{
        bell, control_side, hand_over, others, ring, session, shared, take_back, wait_set,
    };
    // Shows NOD-WAKE (loom), bound: 3 preemptions.
    holds("sleepers: each for a message", Some(3), others);
    // Shows NOD-WAKE (loom), bound: none.
    holds("sleepers: the session changes", None, session);
    // Shows NOD-WAKE (loom), bound: none.
    holds(
        "sleepers: the control side changes an interface",
        None,
        control_side,
    );
    // Shows NOD-WAKE (loom), bound: 3 preemptions.
    holds("sleepers: a link is handed over", Some(3), hand_over);
    // Shows NOD-WAKE (loom), bound: 3 preemptions.
    holds("sleepers: a link is taken back", Some(3), take_back);
    // Shows NOD-WAKE, RNG-WAKE (loom), bound: 2 preemptions.
    holds("sleepers: a ring and a socket", Some(2), ring);
    // Shows NOD-WAKE, RNG-WAKE (loom), bound: 2 preemptions.
    holds("sleepers: two threads at a ring", Some(2), shared);
    // Shows NOD-WAKE (loom), bound: 2 preemptions.
    holds("sleepers: a bell and a sleeper", Some(2), bell);
    // Shows NOD-WAKE, RNG-WAKE (loom), bound: 2 preemptions.
    holds("sleepers: a wait set and a sleeper", Some(2), wait_set);
}

#[test]
fn each_part_of_it_is_needed() {
    macro_rules! fail {
        ($scenario:ident: $($variant:ident)*) => {
            $(fails(
                concat!("sleepers: ", stringify!($variant)),
                Some(2),
                LOST,
                $variant::scenarios::$scenario,
            );)*
        };
    }
    fail!(others: entered_late no_sockets);
    fail!(session: entered_late_for_the_session);
    fail!(control_side: no_wake);
    fail!(ring: not_parked no_look_after_parking);
    fail!(bell: woken_for_ever bell_not_rung);
    fail!(wait_set: set_not_parked no_look_after_parking_in_a_set);
    let unparked = shipped::scenarios::shared_unparked;
    fails(
        "sleepers: unparked by another thread",
        Some(2),
        LOST,
        unparked,
    );
}
