//! Only `unsafe` code or the owner of a `Slot` gets a slice of a slot.

use sm2_io::Segment;

fn slot(segment: &Segment) -> &mut [u8] {
    segment.slot_mut(0, 8)
}

fn main() {}
