//! The ring lane: a sender and a receiver, each with its machine, and the words between them.
//!
//! The code is `sm2-io/src/ring/atomic.rs` and the links of `sm2-proto`; processes are modelled as
//! threads. A lost wake-up leaves a thread asleep for ever, which loom reports as a deadlock. A
//! slot that is written while it can be read is reported as a causality violation.

// Each variant has the same scenarios.
#![allow(clippy::duplicate_mod)]

use sm2_loom_models::{fails, holds, holds_at_each_step};

#[path = "ring/driver.rs"]
mod driver;
#[path = "ring/memory.rs"]
mod memory;
#[path = "ring/socket.rs"]
mod socket;

/// Replaces `sm2-io/src/sync.rs`.
mod sync {
    pub(crate) use loom::sync::atomic::{AtomicU64, Ordering, fence};
}

include!(concat!(env!("OUT_DIR"), "/ring.rs"));

use driver::{Order, Step};
use shipped::scenarios::{self as ring, ALL, LAST, TWO, Terms};

/// An application that holds a message while it waits for the next one.
const HELD: Terms = Terms {
    max_borrowed: 2,
    ..ALL
};

/// A ring of two words, whose messages the application takes and holds together.
const BOTH: Terms = Terms {
    depth: 2,
    max_borrowed: 2,
    ..ALL
};

//= SM2-RNG-005, SM2-RNG-006, SM2-RNG-007, SM2-RNG-008, SM2-RNG-012 loom
#[test]
fn the_last_message_always_comes() {
    // Shows RNG-FIFO, RNG-WAKE (loom), bound: 3 messages; 3 preemptions.
    holds("ring: keep-last", Some(3), || ring::keep_last(LAST));
    // Shows RNG-FIFO, RNG-WAKE (loom), bound: 3 messages, window 3; 3 preemptions.
    holds("ring: keep-last, two words", Some(3), || {
        ring::keep_last(TWO)
    });
    // Shows RNG-FIFO, RNG-WAKE (loom), bound: 3 preemptions.
    holds("ring: the window is full", Some(3), || {
        ring::window_full(LAST)
    });
    // Shows RNG-FIFO, RNG-WAKE (loom), bound: 3 preemptions.
    holds("ring: the window is full, two words", Some(3), || {
        ring::window_full(TWO)
    });
    // Shows RNG-FIFO, RNG-WAKE (loom), bound: depth 2, 5 messages; none.
    holds("ring: the sender goes round", None, || ring::round(TWO));
    // Shows RNG-FIFO, RNG-WAKE (loom), bound: 3 preemptions.
    holds("ring: all is given back", Some(3), || ring::flush(LAST));
}

//= SM2-RNG-005, SM2-RNG-012 loom
#[test]
fn nothing_is_lost_on_a_reliable_link() {
    // Shows RNG-FIFO, RNG-WAKE (loom), bound: 3 messages; 3 preemptions.
    holds("ring: reliable", Some(3), || ring::reliable(ALL));
    // Shows RNG-WAKE (loom), bound: none.
    holds("ring: reliable, a sender waits", None, || ring::room(ALL));
    // Shows RNG-WAKE (loom), bound: window 3; 3 preemptions.
    holds("ring: reliable, one is held", Some(3), || ring::held(HELD));
    // Shows RNG-WAKE (loom), bound: 3 messages, window 4; 3 preemptions.
    holds("ring: a batch", Some(3), || ring::batch(BOTH));
}

//= SM2-RNG-010 loom
#[test]
fn either_side_may_stop() {
    let sender = |terms: Terms, steps| Terms {
        steps: [steps, u32::MAX],
        ..terms
    };
    let receiver = |terms: Terms, steps| Terms {
        steps: [u32::MAX, steps],
        ..terms
    };
    // Shows RNG-FIFO, RNG-WAKE (loom), bound: after each step; 2 preemptions.
    holds_at_each_step("ring: the sender stops", Some(2), move |it| {
        ring::sender_stops(sender(LAST, it))
    });
    // Shows RNG-FIFO, RNG-WAKE (loom), bound: after each step; 2 preemptions.
    holds_at_each_step("ring: the sender stops, reliable", Some(2), move |it| {
        ring::sender_stops(sender(ALL, it))
    });
    // Shows RNG-FIFO, RNG-WAKE (loom), bound: after each step; 2 preemptions.
    holds_at_each_step("ring: the sender stops, window full", Some(2), move |it| {
        ring::sender_stops_full(sender(TWO, it))
    });
    // Shows RNG-FIFO, RNG-WAKE (loom), bound: after each step; 2 preemptions.
    holds_at_each_step("ring: the receiver stops", Some(2), move |it| {
        ring::receiver_stops(receiver(LAST, it))
    });
    // Shows RNG-FIFO, RNG-WAKE (loom), bound: after each step; 2 preemptions.
    holds_at_each_step("ring: the receiver stops, reliable", Some(2), move |it| {
        ring::receiver_stops(receiver(ALL, it))
    });
    // Shows RNG-FIFO, RNG-WAKE (loom), bound: depth 2; none.
    holds("ring: the receiver closes", None, || {
        ring::receiver_closes(TWO)
    });
}

const LOST: &str = "deadlock";
const RACE: &str = "Causality violation";

//= SM2-RNG-012 loom
#[test]
fn each_part_of_it_is_needed() {
    words();
    drivers();
    driver_fences();
}

/// The atomic operations of `sm2-io` on the words of a ring.
fn words() {
    macro_rules! fail {
        ($because:expr, $scenario:ident, $terms:ident: $($variant:ident)*) => {
            $(fails(concat!("ring: ", stringify!($variant)), Some(3), $because, || {
                use $variant::scenarios as broken;
                broken::$scenario(broken::$terms);
            });)*
        };
    }
    fail!(LOST, keep_last, LAST: no_fence weak_fence);
    fail!(RACE, keep_last, LAST: put_without_release taken_without_acquire taken_anyway);
    fail!(RACE, flush, LAST: back_without_acquire);
    fail!("window-exceeded", window_full, LAST: swap_without_acquire);
    fail!("bad-word", round, TWO: load_without_acquire);
    fail!("what is said to be lost", keep_last, LAST: taken_unseen);
    fail!(LOST, keep_last, LAST: put_in_two_steps);
}

/// Runs one scenario of the drivers with `$terms`, which must fail.
macro_rules! driver_fails {
    ($name:literal, $because:expr, $scenario:ident, $terms:expr) => {
        fails(concat!("ring: ", $name), Some(3), $because, || {
            ring::$scenario($terms);
        });
    };
}

const fn sender(terms: Terms, order: Order) -> Terms {
    let order = [order, terms.order[1]];
    Terms { order, ..terms }
}

const fn receiver(terms: Terms, order: Order) -> Terms {
    let order = [terms.order[0], order];
    Terms { order, ..terms }
}

const fn fences(terms: Terms, fences: [bool; 2]) -> Terms {
    Terms { fences, ..terms }
}

const ASLEEP: Order = Order::without(Step::Park);
const BLIND: Order = Order::without(Step::LookAgain);
const SILENT: Order = Order::without(Step::Ring);
const QUIET: Order = Order::without(Step::TellOfRoom);
const HASTY: Order = Order::without(Step::TakeTheRest);

/// The calls that drivers make, and their order.
fn drivers() {
    driver_fails!(
        "receiver sleeps without parking",
        LOST,
        keep_last,
        receiver(LAST, ASLEEP)
    );
    driver_fails!(
        "sender sleeps without parking",
        LOST,
        room,
        sender(ALL, ASLEEP)
    );
    driver_fails!(
        "receiver does not look again",
        LOST,
        keep_last,
        receiver(LAST, BLIND)
    );
    driver_fails!("sender does not look again", LOST, room, sender(ALL, BLIND));
    driver_fails!(
        "sender does not ring",
        LOST,
        keep_last,
        sender(LAST, SILENT)
    );
    driver_fails!("receiver does not ring", LOST, room, receiver(ALL, SILENT));
    driver_fails!(
        "receiver does not tell of room",
        LOST,
        held,
        receiver(HELD, QUIET)
    );
    driver_fails!(
        "receiver takes nothing at the end",
        "a message is left",
        sender_stops,
        receiver(LAST, HASTY)
    );
}

/// The fences in the drivers of both ends.
fn driver_fences() {
    driver_fails!(
        "no fence, sender that put",
        LOST,
        keep_last,
        fences(LAST, [false, true])
    );
    driver_fails!(
        "no fence, receiver that parked",
        LOST,
        keep_last,
        fences(LAST, [true, false])
    );
    driver_fails!(
        "no fence, sender that parked",
        LOST,
        room,
        fences(ALL, [false, true])
    );
    driver_fails!(
        "no fence, receiver that took",
        LOST,
        room,
        fences(ALL, [true, false])
    );
    driver_fails!(
        "no fence after a batch",
        LOST,
        batch,
        fences(BOTH, [true, false])
    );
}
