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
use shipped::scenarios::{self as ring, ALL, Fault, LAST, TWO, Terms};

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

/// All messages travel in cells.
const fn cells(terms: Terms) -> Terms {
    Terms {
        in_cell: |_| true,
        ..terms
    }
}

/// The first message travels in a cell, the second one in a slot, and so on.
const fn odd_cells(terms: Terms) -> Terms {
    Terms {
        in_cell: |id| id % 2 == 1,
        ..terms
    }
}

/// The first message travels in a slot, the second one in a cell, and so on.
const fn even_cells(terms: Terms) -> Terms {
    Terms {
        in_cell: |id| id % 2 == 0,
        ..terms
    }
}

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

//= SM2-RNG-005, SM2-RNG-006, SM2-RNG-012, SM2-RNG-013 loom
#[test]
fn a_message_in_a_cell_is_whole() {
    // Shows RNG-CELL, RNG-FIFO, RNG-WAKE (loom), bound: 3 messages; 2 preemptions.
    holds("ring: cells", Some(2), || ring::keep_last(cells(LAST)));
    // Shows RNG-CELL, RNG-FIFO, RNG-WAKE (loom), bound: 2 messages; 3 preemptions.
    holds("ring: two messages in a cell", Some(3), || {
        ring::torn(cells(LAST))
    });
    // Shows RNG-CELL, RNG-FIFO, RNG-WAKE (loom), bound: 3 messages; 2 preemptions.
    holds("ring: cells, two words", Some(2), || {
        ring::keep_last(cells(TWO))
    });
    // Shows RNG-CELL, RNG-FIFO (loom), bound: depth 2, 5 messages; 2 preemptions.
    holds("ring: cells, the sender goes round", Some(2), || {
        ring::round(cells(TWO))
    });
    // Shows RNG-CELL, RNG-FIFO, RNG-WAKE (loom), bound: 3 messages; 2 preemptions.
    holds("ring: cells, reliable", Some(2), || {
        ring::reliable(cells(ALL))
    });
    // Shows RNG-CELL, RNG-WAKE (loom), bound: none.
    holds("ring: cells, a sender waits", None, || {
        ring::room(cells(ALL))
    });
    // Shows RNG-CELL, RNG-WAKE (loom), bound: 3 preemptions.
    holds("ring: cells, all is taken", Some(3), || {
        ring::flush(cells(LAST))
    });
    // Shows RNG-CELL, RNG-WAKE (loom), bound: 3 messages, window 4; 2 preemptions.
    holds("ring: cells, a batch", Some(2), || ring::batch(cells(BOTH)));
}

//= SM2-RNG-005, SM2-RNG-006, SM2-RNG-013 loom
#[test]
fn cells_and_slots_follow_each_other() {
    // Shows RNG-CELL, RNG-FIFO, RNG-WAKE (loom), bound: 3 messages; 3 preemptions.
    holds("ring: cell, slot, cell", Some(3), || {
        ring::keep_last(odd_cells(LAST))
    });
    // Shows RNG-CELL, RNG-FIFO, RNG-WAKE (loom), bound: 3 messages; 3 preemptions.
    holds("ring: slot, cell, slot", Some(3), || {
        ring::keep_last(even_cells(LAST))
    });
    // Shows RNG-CELL, RNG-FIFO, RNG-WAKE (loom), bound: 3 messages; 2 preemptions.
    holds("ring: cell, slot, cell, reliable", Some(2), || {
        ring::reliable(odd_cells(ALL))
    });
    // Shows RNG-CELL, RNG-FIFO, RNG-WAKE (loom), bound: 2 preemptions.
    holds("ring: a cell where the window is full", Some(2), || {
        ring::window_full(even_cells(LAST))
    });
    // Shows RNG-CELL, RNG-WAKE (loom), bound: 3 preemptions.
    holds("ring: a slot and a cell, all is settled", Some(3), || {
        ring::flush(even_cells(LAST))
    });
}

//= SM2-RNG-010, SM2-RNG-013 loom
#[test]
fn either_side_may_stop_with_cells() {
    // Shows RNG-CELL, RNG-FIFO, RNG-WAKE (loom), bound: after each step; 2 preemptions.
    holds_at_each_step("ring: cells, the sender stops", Some(2), move |it| {
        ring::sender_stops(sender_dies(cells(LAST), it))
    });
    // Shows RNG-CELL, RNG-FIFO, RNG-WAKE (loom), bound: after each step; 2 preemptions.
    holds_at_each_step(
        "ring: a cell, the sender stops, window full",
        Some(2),
        move |it| ring::sender_stops_full(sender_dies(even_cells(TWO), it)),
    );
    // Shows RNG-CELL, RNG-FIFO, RNG-WAKE (loom), bound: after each step; 2 preemptions.
    holds_at_each_step("ring: cells, the receiver stops", Some(2), move |it| {
        ring::receiver_stops(receiver_dies(cells(ALL), it))
    });
    // Shows RNG-CELL, RNG-FIFO, RNG-WAKE (loom), bound: depth 2; 2 preemptions.
    holds("ring: cells, the receiver closes", Some(2), || {
        ring::receiver_closes(cells(TWO))
    });
}

//= SM2-RNG-010 loom
#[test]
fn either_side_may_stop() {
    // Shows RNG-FIFO, RNG-WAKE (loom), bound: after each step; 2 preemptions.
    holds_at_each_step("ring: the sender stops", Some(2), move |it| {
        ring::sender_stops(sender_dies(LAST, it))
    });
    // Shows RNG-FIFO, RNG-WAKE (loom), bound: after each step; 2 preemptions.
    holds_at_each_step("ring: the sender stops, reliable", Some(2), move |it| {
        ring::sender_stops(sender_dies(ALL, it))
    });
    // Shows RNG-FIFO, RNG-WAKE (loom), bound: after each step; 2 preemptions.
    holds_at_each_step("ring: the sender stops, window full", Some(2), move |it| {
        ring::sender_stops_full(sender_dies(TWO, it))
    });
    // Shows RNG-FIFO, RNG-WAKE (loom), bound: after each step; 2 preemptions.
    holds_at_each_step("ring: the receiver stops", Some(2), move |it| {
        ring::receiver_stops(receiver_dies(LAST, it))
    });
    // Shows RNG-FIFO, RNG-WAKE (loom), bound: after each step; 2 preemptions.
    holds_at_each_step("ring: the receiver stops, reliable", Some(2), move |it| {
        ring::receiver_stops(receiver_dies(ALL, it))
    });
    // Shows RNG-FIFO, RNG-WAKE (loom), bound: depth 2; none.
    holds("ring: the receiver closes", None, || {
        ring::receiver_closes(TWO)
    });
}

const fn sender_dies(terms: Terms, steps: u32) -> Terms {
    Terms {
        steps: [steps, u32::MAX],
        ..terms
    }
}

const fn receiver_dies(terms: Terms, steps: u32) -> Terms {
    Terms {
        steps: [u32::MAX, steps],
        ..terms
    }
}

const LOST: &str = "deadlock";
const RACE: &str = "Causality violation";

//= SM2-RNG-012 loom
#[test]
fn each_part_of_it_is_needed() {
    words();
    cell_parts();
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

/// The operations on cells: of `sm2-io` on their words, and of the machines of both ends.
fn cell_parts() {
    macro_rules! fail {
        ($because:expr, $scenario:ident, $terms:ident: $variant:ident) => {
            fails(
                concat!("ring: cells, ", stringify!($variant)),
                Some(3),
                $because,
                || {
                    use $variant::scenarios::{self as broken, Terms};
                    let cells = |terms: Terms| Terms {
                        in_cell: |_| true,
                        ..terms
                    };
                    broken::$scenario(cells(broken::$terms));
                },
            );
        };
    }
    fail!("may still copy it", reliable, ALL: taken_without_release);
    fail!("bad-id", reliable, ALL: load_without_acquire);
    fail!("what is said to be lost", keep_last, LAST: put_without_release);
    fail!("are accounted for", keep_last, LAST: taken_anyway);
    driver_fails!(
        "a copy after its word is taken",
        "may still copy it",
        torn,
        late_copy()
    );
    driver_fails!(
        "a cell that is written early",
        "is torn",
        torn,
        early_write()
    );
    driver_fails!(
        "receiver does not tell that a cell is taken",
        LOST,
        flush,
        receiver(cells(LAST), QUIET)
    );
    driver_fails!(
        "receiver does not tell of room in a cell",
        LOST,
        room,
        receiver(cells(ALL), QUIET)
    );
    driver_fails!(
        "no fence, receiver that took a cell",
        LOST,
        flush,
        fences(cells(LAST), [true, false])
    );
    driver_fails!(
        "no fence, sender that filled a cell",
        LOST,
        keep_last,
        fences(cells(LAST), [false, true])
    );
    driver_fails!(
        "a cell is left",
        "a message is left",
        sender_stops,
        receiver(cells(LAST), HASTY)
    );
}

const fn late_copy() -> Terms {
    Terms {
        fault: Fault::LateCopy,
        ..cells(LAST)
    }
}

const fn early_write() -> Terms {
    Terms {
        fault: Fault::EarlyWrite,
        ..cells(LAST)
    }
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
