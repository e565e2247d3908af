//! Harnesses for [`Attachments`]: one step from any state that it can have.
//!
//! The state has two segments of two slots. A model holds the same state in arrays. Each step
//! changes the model as SPEC section 8.3 prescribes, and the model and the `Attachments` must then
//! be equal.

use super::{Attachments, Misuse, OwnSegment, SegmentFrame, SegmentInfo};
use crate::{
    limits::SEGMENTS_MAX,
    link::segments::{Geometry, Slot},
    proofs::{below, one_of},
};

/// The state of a slot's message.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Use {
    Free,
    Queued,
    Sent,
}

/// The state of an `Attachments`, in arrays.
#[derive(Clone, Copy)]
struct Model {
    slots: [[Use; 2]; 2],
    /// The position of the ATTACH frame of each attached segment.
    attached: [Option<u64>; 2],
    /// A segment that needs a DETACH.
    retired: Option<u32>,
    order: u64,
}

const STRIDE: u64 = 4_096;
const ORDERS: [[u64; 2]; 2] = [[1, 4], [4, 1]];

fn info(segment: usize) -> SegmentInfo {
    SegmentInfo {
        id: segment as u32,
        stride: STRIDE,
        slots: 2,
    }
}

fn at(segment: usize, slot: usize) -> Slot {
    Slot {
        segment: segment as u32,
        slot: slot as u32,
    }
}

impl Model {
    fn any() -> Self {
        let orders = one_of(&ORDERS);
        let mut it = Self {
            slots: [[Use::Free; 2]; 2],
            attached: [None; 2],
            retired: kani::any::<bool>().then_some(0),
            order: 5,
        };
        for (segment, order) in orders.into_iter().enumerate() {
            let attached = kani::any();
            it.attached[segment] = if attached { Some(order) } else { None };
            for slot in 0..2 {
                it.slots[segment][slot] = one_of(&[Use::Free, Use::Queued, Use::Sent]);
                kani::assume(attached || it.slots[segment][slot] != Use::Sent);
            }
        }
        // DETACH is sent before all other frames, so no segment is attached again before that.
        kani::assume(it.retired.is_none() || it.attached[0].is_none());
        it
    }

    fn count(&self, segment: usize, wanted: Use) -> usize {
        self.slots[segment]
            .iter()
            .filter(|it| **it == wanted)
            .count()
    }

    fn is_named(&self, segment: usize) -> bool {
        self.count(segment, Use::Free) < 2
    }

    fn books(&self) -> Attachments {
        let mut books = Attachments {
            order: self.order,
            ..Attachments::default()
        };
        books.retired.extend(self.retired);
        for segment in 0..2 {
            let (named, attached) = (self.is_named(segment), self.attached[segment]);
            let unreleased = self.count(segment, Use::Sent);
            books.named += usize::from(named);
            books.attached += usize::from(attached.is_some());
            if let (Some(order), 0) = (attached, unreleased) {
                books.idle.insert(order, segment as u32);
            }
            if named || attached.is_some() {
                let used = (0..2).filter(|slot| self.slots[segment][*slot] != Use::Free);
                let segment_of = OwnSegment {
                    geometry: Geometry::new(STRIDE, 2).expect("a legal segment"),
                    slots: used.map(|slot| slot as u32).collect(),
                    unreleased,
                    attached,
                };
                books.segments.insert(segment as u32, segment_of);
            }
        }
        books
    }
}

/// A slot is given out only if it holds no message of this link. A segment that is neither named
/// nor attached is removed.
//= SM2-PAY-005, SM2-SEG-004, SM2-SEG-005 kani
// Shows DAT-REFS (Exhaustive), bound: one step from any state of 2 segments of 2 slots.
#[cfg_attr(kani, kani::proof)]
// Two slots, two segments, three uses; a tree of two entries has one node.
#[cfg_attr(kani, kani::unwind(6))]
fn attachments_step() {
    let mut model = Model::any();
    let mut books = model.books();
    books.invariants();
    let (segment, slot) = (below(2), below(2));
    let used = model.slots[segment][slot];
    match below(6) {
        0 => {
            let verdict = books.check(&info(segment), slot as u32);
            let busy = used != Use::Free;
            assert_eq!(verdict, if busy { Err(Misuse::SlotBusy) } else { Ok(()) });
            kani::cover!(used == Use::Sent, "a slot that is outstanding");
            if !busy {
                books.queue(&info(segment), slot as u32);
                model.slots[segment][slot] = Use::Queued;
            }
        }
        1 => {
            // A segment is prepared only for a queued message.
            kani::assume(model.count(segment, Use::Queued) > 0 && model.retired.is_none());
            let step = books.prepare(segment as u32);
            match (model.attached[segment], step) {
                (Some(_), None) => {}
                (None, Some(SegmentFrame::Attach(found))) => {
                    assert!(found == info(segment));
                    model.attached[segment] = Some(model.order);
                    model.order += 1;
                }
                _ => panic!("attached once, before its first message"),
            }
        }
        2 => {
            kani::assume(used == Use::Queued && model.attached[segment].is_some());
            books.sent(at(segment, slot));
            model.slots[segment][slot] = Use::Sent;
        }
        3 => {
            kani::assume(used != Use::Free);
            books.settle(at(segment, slot), used == Use::Sent);
            model.slots[segment][slot] = Use::Free;
            kani::cover!(!model.is_named(segment), "the last message of its segment");
        }
        4 => {
            let verdict = books.retire(segment as u32);
            if model.is_named(segment) {
                assert_eq!(verdict, Err(Misuse::SegmentBusy));
            } else {
                assert_eq!(verdict, Ok(()));
                if model.attached[segment].take().is_some() {
                    assert_eq!(books.retired.pop_back(), Some(segment as u32));
                    kani::cover!(true, "DETACH is due");
                }
            }
        }
        _ => assert_eq!(books.poll_retired(), model.retired.take()),
    }
    assert!(books == model.books());
    books.invariants();
}

/// A slot outside its segment is refused, and so is a slot of a segment whose stride or number of
/// slots has changed.
//= SM2-PAY-003, SM2-SEG-003 kani
// Shows DAT-BOUNDS (Exhaustive), bound: any state of 2 segments; shapes around the limits.
#[cfg_attr(kani, kani::proof)]
#[cfg_attr(kani, kani::unwind(6))]
fn only_slots_of_the_segment_are_used() {
    let model = Model::any();
    let books = model.books();
    let segment = below(3);
    let (stride, slots) = one_of(&[
        (STRIDE, 2),
        (2 * STRIDE, 2),
        (STRIDE, 3),
        (STRIDE + 1, 2),
        (STRIDE, 0),
    ]);
    let given = SegmentInfo {
        id: segment as u32,
        stride,
        slots,
    };
    let slot = one_of(&[0, 1, 2, u32::MAX]);
    let legal = stride % STRIDE == 0 && slots > 0;
    let known = segment < 2 && (model.is_named(segment) || model.attached[segment].is_some());
    let same = given == info(segment);
    let expected = if !legal {
        Err(Misuse::BadSegment)
    } else if slot >= given.slots {
        Err(Misuse::SlotOutside)
    } else if known && !same {
        Err(Misuse::SegmentChanged)
    } else if known && model.slots[segment][slot as usize] != Use::Free {
        Err(Misuse::SlotBusy)
    } else {
        Ok(())
    };
    assert_eq!(books.check(&given, slot), expected);
    kani::cover!(expected == Err(Misuse::SegmentChanged), "another shape");
    kani::cover!(expected.is_ok() && known, "a free slot");
}

/// At the limit, one more segment is attached only after the idle one was detached, and no message
/// is put into a 257th segment.
//= SM2-SEG-004 kani
// Shows LNK-LIMITS (Exhaustive), bound: all 256 in use but any one.
#[cfg_attr(kani, kani::proof)]
// All 256 segments, and the next one.
#[cfg_attr(kani, kani::unwind(258))]
fn no_more_segments_than_the_limit() {
    let idle = below(SEGMENTS_MAX);
    let mut books = Attachments::default();
    for segment in 0..SEGMENTS_MAX {
        books.queue(&info(segment), 0);
        assert!(matches!(
            books.prepare(segment as u32),
            Some(SegmentFrame::Attach(_))
        ));
        books.sent(at(segment, 0));
    }
    let next = SEGMENTS_MAX as u32;
    let next = SegmentInfo {
        id: next,
        ..info(0)
    };
    assert_eq!(books.check(&next, 0), Err(Misuse::SegmentLimit));
    books.settle(at(idle, 0), true);
    assert_eq!(books.check(&next, 0), Ok(()));
    books.queue(&next, 0);
    match books.prepare(next.id) {
        Some(SegmentFrame::Detach(found)) => assert!(found as usize == idle),
        _ => panic!("one has to go"),
    }
    assert!(matches!(
        books.prepare(next.id),
        Some(SegmentFrame::Attach(_))
    ));
    assert!(books.prepare(next.id).is_none());
    books.invariants();
    kani::cover!(idle == SEGMENTS_MAX - 1, "the last one is idle");
}

#[cfg(test)]
kani::explored! {
    attachments_step: 3,
    only_slots_of_the_segment_are_used: 2,
    no_more_segments_than_the_limit: 1,
}
