//! Two slices of one slot are kept apart by `unsafe` or by the ownership of `Slot`.

use sm2_io::Segment;

fn slot(segment: &Segment) -> &mut [u8] {
    segment.slot_mut(0, 8)
}

fn main() {}
