//! Violations by one end of a link towards the other.
//!
//! The real end is an interface of a real node. The raw end belongs to a raw node of the same domain.

mod calls;
mod cells;
mod flow;
mod frames;
mod layout;
mod memory;
mod opening;
mod ring;
mod ring_memory;
mod stage;

pub use stage::{LinkRow, LinkStage, Real, WINDOW};

use stage::Rows;

/// All rows.
#[must_use]
pub fn rows() -> Rows {
    let mut rows = frames::rows();
    rows.extend(opening::rows());
    rows.extend(layout::rows());
    rows.extend(memory::rows());
    rows.extend(flow::rows());
    rows.extend(ring::rows());
    rows.extend(ring_memory::rows());
    rows.extend(cells::rows());
    rows.extend(calls::rows());
    rows
}

/// The rows for a victim that has few descriptors to spare.
#[must_use]
pub fn starved_rows() -> Rows {
    frames::starved()
}

/// Frames that would break two rules at once, with the rule that SPEC section 10 names
/// first.
#[must_use]
pub fn precedence() -> Rows {
    frames::precedence()
}
