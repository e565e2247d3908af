//! Threads that wait at a node: what one of them receives for another wakes that one.
//!
//! The code is `sm2-node/src/driver/wait.rs`; `kernel` is what it asks of Linux. A wake-up that
//! is lost leaves a thread asleep for ever, which loom reports as a deadlock.

// Each variant has the same scenarios.
#![allow(clippy::duplicate_mod)]

use sm2_loom_models::{fails, holds};

#[path = "sleepers/kernel.rs"]
mod kernel;

include!(concat!(env!("OUT_DIR"), "/sleepers.rs"));

const LOST: &str = "deadlock";

#[test]
fn no_wake_up_is_lost() {
    use shipped::scenarios::{bell, others, session};
    holds("sleepers: each for a message", Some(3), others);
    holds("sleepers: the session changes", None, session);
    holds("sleepers: a bell and a sleeper", Some(2), bell);
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
    fail!(others: no_wake entered_late no_sockets);
    fail!(session: own_topic_only);
    fail!(bell: woken_for_ever bell_not_rung);
}
