//! Harnesses for the receiving side: one step from any state that an `Inbound` can have.

use super::{Delivery, Geometry, Inbound, Ready, Segment, Slot};
use crate::{
    FdFacts, Instant, LinkId, Seals, VERSION,
    limits::{INLINE_MAX, MESSAGE_MAX, SEGMENTS_MAX},
    link::{
        Carrier, Config, FrameKind, Payload, Role, SegmentInfo, Status,
        ring::RingSegments,
        wire::{Form, MessageFrame},
    },
    proofs::{below, one_of},
};

const STRIDE: u64 = 4_096;

/// The state of a received message.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Stage {
    Ready,
    Borrowed,
    Consumed,
    Discarded,
    Released,
}

const STAGES: [Stage; 5] = [
    Stage::Ready,
    Stage::Borrowed,
    Stage::Consumed,
    Stage::Discarded,
    Stage::Released,
];

/// The sequence number of the first message: small, beyond 32 bits, and near the end.
const FIRST: [u64; 3] = [1, 1 << 32, u64::MAX - 2];

struct State<const N: usize> {
    books: Inbound,
    stages: [Stage; N],
    first: u64,
    pooled: bool,
}

fn slot(at: usize, pooled: bool) -> Option<Slot> {
    pooled.then_some(Slot {
        segment: 3,
        slot: at as u32,
    })
}

impl<const N: usize> State<N> {
    /// The last messages, each at any stage. A pooled message is in the slot with the index of the
    /// message.
    fn any() -> Self {
        let config = Config {
            id: LinkId::FIRST,
            version: VERSION,
            role: Role::Receiver,
            reliable: kani::any(),
            sealed: false,
            ring: false,
            depth: 1,
            max_borrowed: 1,
        };
        let (pooled, first): (bool, u64) = (kani::any(), one_of(&FIRST));
        let mut books = Inbound::new(&config);
        let geometry = Geometry::new(STRIDE, 4).expect("a legal segment");
        let mut segment = Segment {
            geometry,
            busy: Default::default(),
        };
        let mut stages = [Stage::Released; N];
        for (at, stage) in stages.iter_mut().enumerate() {
            *stage = one_of(&STAGES);
            let sequence = first + at as u64;
            let slot = slot(at, pooled);
            let delivery = Delivery {
                sequence,
                id: sequence,
                time: Instant(0),
                status: Status::Ok,
                lost: 0,
                len: 0,
                payload: Payload::Sealed,
            };
            let _ = match stage {
                Stage::Ready => {
                    books.ready.push_back(Ready { delivery, slot });
                    None
                }
                Stage::Borrowed => books.borrowed.insert(sequence, slot),
                Stage::Consumed => books.consumed.insert(sequence, slot),
                Stage::Discarded => books.discarded.insert(sequence, slot),
                Stage::Released => continue,
            };
            segment.busy.extend(slot.map(|it| it.slot));
        }
        books.segments.insert(3, segment);
        books.sequence = first + (N as u64 - 1);
        books.last_id = Some(books.sequence);
        books.next_id = Some(first);
        let count = |wanted| stages.iter().filter(|it| **it == wanted).count();
        kani::assume(count(Stage::Ready) <= 1 || !books.displaces);
        kani::assume(count(Stage::Borrowed) <= 1);
        kani::assume(N - count(Stage::Released) <= books.window);
        let state = Self {
            books,
            stages,
            first,
            pooled,
        };
        state.books.invariants();
        state
    }

    fn count(&self, wanted: Stage) -> usize {
        self.stages.iter().filter(|it| **it == wanted).count()
    }

    fn unreleased(&self) -> usize {
        N - self.count(Stage::Released)
    }
}

/// A message is admitted exactly if it obeys the rules of SPEC section 8 for flow, form, slot and
/// file.
//= SM2-MSG-001, SM2-MSG-002, SM2-MSG-003, SM2-PAY-001, SM2-PAY-002, SM2-PAY-005, SM2-PAY-008 kani
//= SM2-SEG-001, SM2-SEG-002 kani
#[cfg_attr(kani, kani::proof)]
// Two messages; trees of at most two entries.
#[cfg_attr(kani, kani::unwind(8))]
fn a_message_is_admitted_exactly() {
    let mut state = State::<2>::any();
    let books = &mut state.books;
    let last = books.sequence;
    let (right_number, right_id): (bool, bool) = kani::any();
    let form = one_of(&[
        Form::Inline,
        Form::Sealed,
        Form::Pooled {
            segment: 3,
            slot: 0,
        },
        Form::Pooled {
            segment: 3,
            slot: 3,
        },
        Form::Pooled {
            segment: 3,
            slot: 4,
        },
        Form::Pooled {
            segment: 4,
            slot: 0,
        },
    ]);
    let limit = match form {
        Form::Inline => INLINE_MAX as u64,
        Form::Pooled { .. } => STRIDE,
        Form::Sealed => MESSAGE_MAX,
    };
    let len = one_of(&[0, limit, limit + 1]);
    let frame = MessageFrame {
        carrier: Carrier::Data,
        form,
        status: Status::Ok,
        sequence: if right_number {
            last.wrapping_add(1)
        } else {
            one_of(&[0, last])
        },
        id: if right_id {
            last.saturating_add(1)
        } else {
            last
        },
        time: Instant(0),
        len,
        rest: &[],
    };
    let (size_bytes, seals) = match form {
        Form::Sealed => (
            one_of(&[len, len.saturating_sub(1)]),
            one_of(&[Seals::SEALED, Seals::POOLED]),
        ),
        _ => (0, Seals(0)),
    };
    let file = FdFacts {
        regular: true,
        size_bytes,
        seals,
    };
    let window_used = state.stages.iter().all(|it| *it != Stage::Released);
    let expected = if !right_number || last == u64::MAX {
        Err(violation!(BadSequence, "SM2-MSG-001"))
    } else if !right_id {
        Err(violation!(BadId, "SM2-MSG-002"))
    } else if window_used {
        Err(violation!(WindowExceeded, "SM2-MSG-003"))
    } else {
        match form {
            Form::Pooled { segment: 4.., .. } => Err(violation!(UnknownSegment, "SM2-PAY-002")),
            Form::Pooled { slot: 4.., .. } => Err(violation!(BadSlot, "SM2-PAY-002")),
            Form::Inline if len > limit => Err(violation!(BadLength, "SM2-PAY-001")),
            Form::Pooled { .. } if len > limit => Err(violation!(BadLength, "SM2-PAY-002")),
            Form::Sealed if len > limit => Err(violation!(BadLength, "SM2-PAY-008")),
            Form::Pooled { slot: 0, .. } if state.pooled && state.stages[0] != Stage::Released => {
                Err(violation!(SlotBusy, "SM2-PAY-005"))
            }
            Form::Sealed if file.seals != Seals::SEALED => {
                Err(violation!(SealsMissing, "SM2-SEG-001"))
            }
            Form::Sealed if file.size_bytes < len => Err(violation!(BadSize, "SM2-SEG-002")),
            _ => Ok(()),
        }
    };
    let verdict = books.check(&frame, &[file]);
    kani::cover!(
        expected == Err(violation!(SlotBusy, "SM2-PAY-005")),
        "its slot is taken"
    );
    kani::cover!(
        expected == Err(violation!(WindowExceeded, "SM2-MSG-003")),
        "its window is full"
    );
    kani::cover!(expected.is_ok() && form == Form::Sealed, "a sealed message");
    match verdict {
        Ok(checked) => {
            assert_eq!(expected, Ok(()));
            let ready = books.ready.len();
            let displaced = books.accept(checked);
            assert_eq!(books.sequence, last + 1);
            assert_eq!(displaced.is_some(), books.displaces && ready == 1);
            assert_eq!(
                books.ready(),
                if displaced.is_some() { 1 } else { ready + 1 }
            );
            if let Form::Pooled { slot, .. } = form {
                assert!(books.segments[&3].busy.contains(&slot));
            }
            books.invariants();
        }
        Err(violation) => assert_eq!(expected, Err(violation)),
    }
}

/// Each message is taken once, given back once and released once. Messages are released in order,
/// and displaced messages before the messages that the application gave back.
//= SM2-MSG-004, SM2-MSG-005, SM2-PAY-005 kani
#[cfg_attr(kani, kani::proof)]
#[cfg_attr(kani, kani::unwind(8))]
fn each_message_is_released_once() {
    let mut state = State::<3>::any();
    let (ready, unreleased) = (state.count(Stage::Ready), state.unreleased());
    let oldest = |wanted| state.stages.iter().position(|it| *it == wanted);
    let books = &mut state.books;
    match below(3) {
        0 => match books.take() {
            Ok(Some(delivery)) => {
                assert!(oldest(Stage::Borrowed).is_none(), "one at a time");
                let at = oldest(Stage::Ready).expect("one is ready");
                assert_eq!(delivery.sequence, state.first + at as u64);
                assert_eq!(books.ready(), ready - 1);
                assert!(books.borrowed.contains_key(&delivery.sequence));
                // No earlier message was taken here, so all earlier ones were lost.
                assert_eq!(delivery.lost, at as u64);
            }
            Ok(None) => assert_eq!(ready, 0),
            Err(_) => assert!(ready > 0 && oldest(Stage::Borrowed).is_some()),
        },
        1 => {
            let at = below(4);
            let sequence = state.first.wrapping_add(at as u64);
            let held = at < 3 && state.stages[at] == Stage::Borrowed;
            assert_eq!(books.release(sequence), held);
            assert!(!books.release(sequence), "given back once");
            assert_eq!(
                books.consumed.contains_key(&sequence),
                at < 3 && matches!(state.stages[at], Stage::Borrowed | Stage::Consumed)
            );
            kani::cover!(held, "given back");
        }
        _ => {
            let (stage, fate) = if oldest(Stage::Discarded).is_some() {
                (Stage::Discarded, 1)
            } else {
                (Stage::Consumed, 0)
            };
            let count = state.stages.iter().filter(|it| **it == stage).count();
            let packet = books.poll();
            assert_eq!(packet.is_some(), count > 0);
            kani::cover!(count == 2, "two in one RELEASE");
            if let Some(packet) = packet {
                let bytes = packet.to_vec();
                assert_eq!(bytes[..4], [FrameKind::Release as u8, fate, count as u8, 0]);
                let mut named = bytes[8..].chunks_exact(8);
                for (at, it) in state
                    .stages
                    .iter()
                    .enumerate()
                    .filter(|(_, it)| **it == stage)
                {
                    let sequence = state.first + at as u64;
                    assert!(named.next() == Some(&sequence.to_le_bytes()[..]));
                    let busy = &books.segments[&3].busy;
                    assert!(
                        *it == stage && !busy.contains(&(at as u32)),
                        "its slot is free"
                    );
                }
                assert!(named.next().is_none());
                assert_eq!(books.unreleased(), unreleased - count);
            }
        }
    }
    books.invariants();
}

/// Creates the segments of the ring lane with these segments attached. `leaving` is a segment that
/// was attached and detached and for which DETACHED was not sent.
fn ring_segments(attached: impl Iterator<Item = u32>, leaving: Option<u32>) -> RingSegments {
    let mut ring = RingSegments::default();
    let file = FdFacts {
        regular: true,
        size_bytes: STRIDE,
        seals: Seals::POOLED,
    };
    for id in attached.chain(leaving) {
        let info = SegmentInfo {
            id,
            stride: STRIDE,
            slots: 1,
        };
        assert_eq!(ring.attach(&info, &[file]), Ok(()));
    }
    if let Some(id) = leaving {
        assert_eq!(ring.detach(id), Ok(()));
    }
    ring
}

/// A segment can be attached if its number is free, and detached if none of its slots is in use.
//= SM2-SEG-001, SM2-SEG-003, SM2-SEG-005 kani
#[cfg_attr(kani, kani::proof)]
#[cfg_attr(kani, kani::unwind(8))]
fn segments_come_and_go() {
    let mut state = State::<2>::any();
    let busy = state.pooled && state.unreleased() > 0;
    let books = &mut state.books;
    let id = one_of(&[2, 3, 4]);
    if kani::any() {
        let expected = match id {
            3 if busy => Err(violation!(SegmentBusy, "SM2-SEG-005")),
            3 => Ok(()),
            _ => Err(violation!(UnknownSegment, "SM2-SEG-005")),
        };
        assert_eq!(books.detach(id), expected);
        assert_eq!(books.segments.contains_key(&3), expected.is_err());
        kani::cover!(expected.is_ok(), "detached");
    } else {
        let info = SegmentInfo {
            id,
            stride: one_of(&[STRIDE, STRIDE + 1]),
            slots: one_of(&[0, 2]),
        };
        let file = FdFacts {
            regular: kani::any(),
            size_bytes: one_of(&[2 * STRIDE, STRIDE]),
            seals: one_of(&[Seals::POOLED, Seals::SEALED]),
        };
        // On the ring lane, one more number is not free, because its DETACHED was not sent.
        let mut ring = RingSegments::default();
        let is_ring = kani::any();
        let is_leaving = is_ring && kani::any();
        if is_ring {
            ring = ring_segments([3].into_iter(), is_leaving.then_some(2));
        }
        let taken = id == 3 || is_leaving && id == 2;
        let expected = if !file.regular {
            Err(violation!(NotAMemfd, "SM2-SEG-001"))
        } else if file.seals != Seals::POOLED {
            Err(violation!(SealsMissing, "SM2-SEG-001"))
        } else if taken {
            Err(violation!(SegmentNumber, "SM2-SEG-003"))
        } else if info.stride != STRIDE || info.slots == 0 {
            Err(violation!(BadSegment, "SM2-SEG-003"))
        } else if file.size_bytes != 2 * STRIDE {
            Err(violation!(BadSize, "SM2-SEG-003"))
        } else {
            Ok(())
        };
        let (verdict, is_there) = match is_ring {
            true => (ring.attach(&info, &[file]), ring.geometry(id).is_some()),
            false => {
                let verdict = books.attach(&info, &[file]);
                (verdict, books.segments.contains_key(&id))
            }
        };
        assert_eq!(verdict, expected);
        assert_eq!(is_there, expected.is_ok() || id == 3);
        kani::cover!(expected.is_ok(), "attached");
        kani::cover!(
            expected == Err(violation!(SegmentNumber, "SM2-SEG-003")) && id == 2,
            "its number is not free yet"
        );
    }
    books.invariants();
}

/// The 257th segment is refused, whatever its number.
//= SM2-SEG-004 kani
#[cfg_attr(kani, kani::proof)]
// All 256 segments, and the next one.
#[cfg_attr(kani, kani::unwind(258))]
fn one_segment_too_many_is_refused() {
    let mut state = State::<1>::any();
    let is_ring = kani::any();
    // Segments of the ring lane for which DETACHED was not sent count as well.
    let is_leaving = is_ring && kani::any();
    let attached = SEGMENTS_MAX - below(2) - usize::from(is_leaving);
    let file = FdFacts {
        regular: true,
        size_bytes: STRIDE,
        seals: Seals::POOLED,
    };
    let info = |id| SegmentInfo {
        id,
        stride: STRIDE,
        slots: 1,
    };
    let next = info(one_of(&[0, 999, 5_000, 32_767]));
    // One segment is already attached.
    let ids = 1_000..1_000 + attached as u32 - 1;
    let verdict = if is_ring {
        let mut ring = ring_segments([3].into_iter().chain(ids), is_leaving.then_some(9_999));
        ring.attach(&next, &[file])
    } else {
        for id in ids {
            assert_eq!(state.books.attach(&info(id), &[file]), Ok(()));
        }
        state.books.attach(&next, &[file])
    };
    let full = attached + usize::from(is_leaving) >= SEGMENTS_MAX;
    assert_eq!(
        verdict,
        if full {
            Err(violation!(SegmentLimit, "SM2-SEG-004"))
        } else {
            Ok(())
        }
    );
    state.books.invariants();
    kani::cover!(full, "one too many");
    kani::cover!(!full, "the last one");
}

#[cfg(test)]
kani::explored! {
    a_message_is_admitted_exactly: 3,
    each_message_is_released_once: 2,
    segments_come_and_go: 3,
    one_segment_too_many_is_refused: 2,
}
