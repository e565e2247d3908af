//! Sizes of slots and segments.

use sm2_proto::limits::STRIDE_UNIT;

/// Number of bytes at the end of each slot that are reserved for the message's head.
pub(crate) const HEAD_BYTES: u64 = sm2_proto::limits::SLOT_HEAD as u64;

/// The size of the smallest slot: two cache lines, which processors fetch together.
pub(super) const STRIDE_MIN: u64 = 128;

/// Sizes of slots from this size on are multiples of it.
pub(super) const PAGE: u64 = 4 << 10;

/// The same for large slots.
pub(super) const HUGE_PAGE: u64 = 2 << 20;

/// The largest size that a segment with several slots grows to. Closing the file of a segment frees all of its pages in
/// one system call.
pub(super) const SEGMENT_BYTES: u64 = 32 << 20;

/// Returns the size of the slot for a message of `len` bytes and its head.
pub(crate) const fn stride_for(len: u64) -> u64 {
    let least = len.saturating_add(HEAD_BYTES);
    let whole = if least > STRIDE_MIN {
        least.next_power_of_two()
    } else {
        STRIDE_MIN
    };
    let half_step = whole / 4 * 3;
    let size = if least <= half_step { half_step } else { whole };
    let unit = match size {
        ..PAGE => STRIDE_UNIT,
        PAGE..HUGE_PAGE => PAGE,
        HUGE_PAGE.. => HUGE_PAGE,
    };
    // As `next_multiple_of`, without a division: each unit is a power of two.
    (size + unit - 1) & !(unit - 1)
}

/// Returns how many slots the first segment of a class has.
pub(super) const fn first_slots(stride: u64) -> u32 {
    match stride {
        // One page of slots.
        0..=0x80 => 32,
        0x81..=0x1_0000 => 16,
        0x1_0001..=0x10_0000 => 4,
        _ => 1,
    }
}
