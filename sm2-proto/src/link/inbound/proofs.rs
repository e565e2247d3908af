//! Harnesses for the receiving side: one step from any state that an `Inbound` can have.

mod state;

use self::state::{Stage, State};
use crate::{
    FdFacts, Instant, Seals, Violation,
    limits::{INLINE_MAX, MESSAGE_MAX, SEGMENTS_MAX},
    link::{
        Carrier, FrameKind, SegmentInfo, Status,
        ring::RingSegments,
        wire::{Form, Given, MessageFrame},
    },
    proofs::{below, one_of},
};

const STRIDE: u64 = 4_096;

/// The length of the longest message of this form.
fn longest(form: Form) -> u64 {
    match form {
        Form::Inline => INLINE_MAX as u64,
        Form::Pooled { .. } => STRIDE,
        Form::Sealed => MESSAGE_MAX,
    }
}

/// A message that arrives, and which of its numbers are right.
struct Arrival {
    frame: MessageFrame<'static>,
    file: FdFacts,
    right_number: bool,
    right_id: bool,
}

impl Arrival {
    /// Any message after the one with the number `last`.
    fn any(last: u64) -> Self {
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
        let limit = longest(form);
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
        Self {
            frame,
            file,
            right_number,
            right_id,
        }
    }

    /// The first rule of SPEC section 8 that the message breaks.
    fn expected(&self, state: &State<2>) -> Result<(), Violation> {
        let Self { frame, file, .. } = self;
        let limit = longest(frame.form);
        let window_used = state.stages.iter().all(|it| *it != Stage::Released);
        if !self.right_number || state.books.sequence == u64::MAX {
            Err(violation!(BadSequence, "SM2-MSG-001"))
        } else if !self.right_id {
            Err(violation!(BadId, "SM2-MSG-002"))
        } else if window_used {
            Err(violation!(WindowExceeded, "SM2-MSG-003"))
        } else {
            match frame.form {
                Form::Pooled { .. } if state.books.sealed => {
                    Err(violation!(NotSealed, "SM2-PAY-001"))
                }
                Form::Pooled { segment: 4.., .. } => Err(violation!(UnknownSegment, "SM2-PAY-003")),
                Form::Pooled { slot: 4.., .. } => Err(violation!(BadSlot, "SM2-PAY-003")),
                Form::Inline if frame.len > limit => Err(violation!(BadLength, "SM2-PAY-002")),
                Form::Pooled { .. } if frame.len > limit => {
                    Err(violation!(BadLength, "SM2-PAY-003"))
                }
                Form::Sealed if frame.len > limit => Err(violation!(BadLength, "SM2-PAY-008")),
                Form::Pooled { slot: 0, .. }
                    if state.pooled && state.stages[0] != Stage::Released =>
                {
                    Err(violation!(SlotBusy, "SM2-PAY-005"))
                }
                _ if frame.len > state.books.max_len => {
                    Err(violation!(MessageTooLong, "SM2-PAY-010"))
                }
                Form::Sealed if file.seals != Seals::SEALED => {
                    Err(violation!(SealsMissing, "SM2-SEG-001"))
                }
                Form::Sealed if file.size_bytes < frame.len => {
                    Err(violation!(BadSize, "SM2-SEG-002"))
                }
                _ => Ok(()),
            }
        }
    }
}

/// A message is admitted exactly if it obeys the rules of SPEC section 8 for flow, form, slot and
/// file.
//= SM2-MSG-001, SM2-MSG-002, SM2-MSG-003, SM2-PAY-002, SM2-PAY-003, SM2-PAY-005, SM2-PAY-008 kani
//= SM2-PAY-001, SM2-PAY-010, SM2-SEG-001, SM2-SEG-002 kani
// Shows LNK-ADMIT (Exhaustive), bound: one step from any state of 2 messages, each at any of 5 stages; numbers up to
// 2^64 - 1.
#[cfg_attr(kani, kani::proof)]
// Two messages; trees of at most two entries.
#[cfg_attr(kani, kani::unwind(8))]
fn a_message_is_admitted_exactly() {
    let mut state = State::<2>::any();
    let last = state.books.sequence;
    let arrival = Arrival::any(last);
    // The maximum is the length of the message, or less.
    let is_next = arrival.right_number && arrival.right_id;
    let is_short = is_next && arrival.file.seals == Seals::SEALED && kani::any();
    state.books.max_len = arrival.frame.len.saturating_sub(u64::from(is_short));
    let expected = arrival.expected(&state);
    let Arrival { frame, file, .. } = arrival;
    let form = frame.form;
    let books = &mut state.books;
    let verdict = books.check(&frame, &[file]);
    kani::cover!(
        expected == Err(violation!(SlotBusy, "SM2-PAY-005")),
        "its slot is taken"
    );
    kani::cover!(
        expected == Err(violation!(WindowExceeded, "SM2-MSG-003")),
        "its window is full"
    );
    kani::cover!(
        expected == Err(violation!(NotSealed, "SM2-PAY-001")),
        "its link is sealed"
    );
    kani::cover!(
        expected == Err(violation!(MessageTooLong, "SM2-PAY-010")),
        "it is longer than this end accepts"
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
                books.untaken(),
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
// Shows LNK-WINDOW (Exhaustive), bound: one step from any state of 3 messages, each at any of 5 stages.
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
                assert_eq!(books.untaken(), ready - 1);
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
            assert_eq!(books.release(sequence, Given::Consumed), held);
            assert!(!books.release(sequence, Given::Consumed), "given back once");
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
                    let mut segments = books.segments.values();
                    assert!(
                        *it == stage && segments.all(|it| !it.busy.contains(&(at as u32))),
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
/// was attached and detached, without a DETACHED that was sent.
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

/// A segment can be attached if its number is free and the link is not sealed, and detached if none
/// of its slots is in use.
//= SM2-PAY-001, SM2-SEG-001, SM2-SEG-003, SM2-SEG-005 kani
// Shows LNK-ADMIT (Exhaustive), bound: one step from any state of 2 messages and a segment.
#[cfg_attr(kani, kani::proof)]
#[cfg_attr(kani, kani::unwind(8))]
fn segments_come_and_go() {
    let id = one_of(&[2, 3, 4]);
    // The ring lane has no state of messages at its segments, so it needs no state of messages here.
    match below(3) {
        0 => detach_any(id),
        1 => {
            let mut books = State::<2>::any().books;
            let attach = Attach::any(id);
            let was_there = books.segments.contains_key(&id);
            let expected = if books.sealed {
                Err(violation!(NotSealed, "SM2-PAY-001"))
            } else {
                attach.expected(was_there)
            };
            assert_eq!(books.attach(&attach.info, &[attach.file]), expected);
            let is_there = books.segments.contains_key(&id);
            assert_eq!(is_there, was_there || expected.is_ok());
            kani::cover!(is_there && !was_there, "attached");
            books.invariants();
        }
        _ => {
            // One more number is not free, because its DETACHED was not sent.
            let is_leaving: bool = kani::any();
            let mut ring = ring_segments([3].into_iter(), is_leaving.then_some(2));
            let attach = Attach::any(id);
            let is_taken = id == 3 || is_leaving && id == 2;
            let expected = attach.expected(is_taken);
            assert_eq!(ring.attach(&attach.info, &[attach.file]), expected);
            assert_eq!(ring.geometry(id).is_some(), expected.is_ok() || id == 3);
            kani::cover!(expected.is_ok(), "attached on the ring lane");
            kani::cover!(
                expected == Err(violation!(BadSegmentId, "SM2-SEG-003")) && id == 2,
                "its number is not free yet"
            );
        }
    }
}

fn detach_any(id: u32) {
    let mut state = State::<2>::any();
    let busy = state.pooled && state.unreleased() > 0;
    let expected = match id {
        _ if state.books.sealed => Err(violation!(UnknownSegment, "SM2-SEG-005")),
        3 if busy => Err(violation!(SegmentBusy, "SM2-SEG-005")),
        3 => Ok(()),
        _ => Err(violation!(UnknownSegment, "SM2-SEG-005")),
    };
    assert_eq!(state.books.detach(id), expected);
    let has_segment = !state.books.sealed && expected.is_err();
    assert_eq!(state.books.segments.contains_key(&3), has_segment);
    kani::cover!(expected.is_ok(), "detached");
    state.books.invariants();
}

/// An ATTACH with its file.
struct Attach {
    info: SegmentInfo,
    file: FdFacts,
}

impl Attach {
    fn any(id: u32) -> Self {
        Self {
            info: SegmentInfo {
                id,
                stride: one_of(&[STRIDE, STRIDE + 1]),
                slots: one_of(&[0, 2]),
            },
            file: FdFacts {
                regular: kani::any(),
                size_bytes: one_of(&[2 * STRIDE, STRIDE]),
                seals: one_of(&[Seals::POOLED, Seals::SEALED]),
            },
        }
    }

    /// The first rule that ATTACH breaks. `is_taken` says whether its number is not free.
    fn expected(&self, is_taken: bool) -> Result<(), Violation> {
        if !self.file.regular {
            Err(violation!(NotAMemfd, "SM2-SEG-001"))
        } else if self.file.seals != Seals::POOLED {
            Err(violation!(SealsMissing, "SM2-SEG-001"))
        } else if is_taken {
            Err(violation!(BadSegmentId, "SM2-SEG-003"))
        } else if self.info.stride != STRIDE || self.info.slots == 0 {
            Err(violation!(BadSegment, "SM2-SEG-003"))
        } else if self.file.size_bytes != 2 * STRIDE {
            Err(violation!(BadSize, "SM2-SEG-003"))
        } else {
            Ok(())
        }
    }
}

/// The 257th segment is refused, whatever its number.
//= SM2-SEG-004 kani
// Shows LNK-LIMITS (Exhaustive), bound: 255 or 256 attached segments.
#[cfg_attr(kani, kani::proof)]
// All 256 segments, and the next one.
#[cfg_attr(kani, kani::unwind(258))]
fn one_segment_too_many_is_refused() {
    let mut state = State::<1>::of_link(false);
    let is_ring = kani::any();
    // Segments of the ring lane whose DETACHED was not sent count as well.
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
    a_message_is_admitted_exactly: 5,
    each_message_is_released_once: 2,
    segments_come_and_go: 4,
    one_segment_too_many_is_refused: 2,
}
