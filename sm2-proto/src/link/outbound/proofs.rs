//! Harnesses for the sending side: one step from any state that an `Outbound` can have.
//!
//! A message is *outstanding* if it was sent and not released. The keys of the messages are 10, 20,
//! … in the order in which they were sent or queued. The id of a message is its key plus one.

use alloc::vec::Vec;

use super::{
    Body, Config, Fate, Frame, Given, Misuse, Outbound, OutboundMessage, Role, SegmentInfo, Slot,
    Status, Unreleased,
};
use crate::{
    Instant, LinkId, Period, VERSION,
    link::{FrameKind, MaxLen, Packet, Publications},
    proofs::{below, one_of},
};

/// How many messages were sent before the step, released or not.
const SENT: usize = 3;

/// The sequence number of the last message that was sent: one beyond 32 bits, and the largest.
const SEQUENCES: [u64; 2] = [(1 << 32) + 1, u64::MAX];

/// How many messages are admitted and how many are waiting.
const QUEUED: [(usize, usize); 4] = [(0, 0), (1, 0), (0, 2), (1, 1)];

const SEGMENT: SegmentInfo = SegmentInfo {
    id: 7,
    stride: 4_096,
    slots: 8,
};

struct State {
    books: Outbound,
    /// Which of the last three sent messages are outstanding, the oldest first.
    outstanding: [bool; SENT],
    admitted: usize,
    waiting: usize,
    /// Whether messages are pooled, each in the slot with the message's number.
    pooled: bool,
}

fn message(number: usize, pooled: bool) -> OutboundMessage {
    let key = 10 * number as u64;
    OutboundMessage {
        key,
        id: key + 1,
        time: Instant(0),
        status: Status::Ok,
        len: 0,
        body: if pooled {
            Body::Pooled {
                segment: SEGMENT,
                slot: number as u32,
            }
        } else {
            Body::Inline(bytes::Bytes::new())
        },
    }
}

fn slot(number: usize, pooled: bool) -> Option<Slot> {
    pooled.then_some(Slot {
        segment: SEGMENT.id,
        slot: number as u32,
    })
}

impl State {
    fn any() -> Self {
        Self::with(kani::any(), one_of(&QUEUED), kani::any(), kani::any())
    }

    /// Creates a state whose window fits the waiting messages: while a message waits, the window is
    /// full.
    fn with(
        outstanding: [bool; SENT],
        (admitted, waiting): (usize, usize),
        pooled: bool,
        reliable: bool,
    ) -> Self {
        let config = Config {
            id: LinkId::FIRST,
            version: VERSION,
            role: Role::Sender,
            reliable,
            sealed: false,
            ring: false,
            depth: 2,
            max_borrowed: 1,
            max_len: MaxLen::GREATEST,
            deadline: Period::NONE,
            lifespan: Period(1),
            lease: Period::NONE,
            publications: Publications::UNKNOWN,
        };
        let mut books = Outbound::new(&config);
        let last = one_of(&SEQUENCES);
        books.sequence = last;
        let numbers = (1..).zip(outstanding).filter(|(_, is)| *is);
        let sent: Vec<usize> = numbers.map(|(number, _)| number).collect();
        let used = sent.len() + admitted;
        let spare = usize::from(waiting == 0 && kani::any());
        books.window = used + spare;
        for number in &sent {
            let message = message(*number, pooled);
            if pooled {
                books.attachments.queue(&SEGMENT, *number as u32);
                books.attachments.prepare(SEGMENT.id);
            }
            let unreleased = Unreleased {
                key: message.key,
                id: message.id,
                slot: slot(*number, pooled),
            };
            if let Some(slot) = unreleased.slot {
                books.attachments.sent(slot);
            }
            let sequence = last - SENT as u64 + *number as u64;
            books.unreleased.insert(sequence, unreleased);
        }
        for number in SENT..SENT + admitted + waiting {
            let message = message(number + 1, pooled);
            if pooled {
                books.attachments.queue(&SEGMENT, number as u32 + 1);
            }
            if number < SENT + admitted {
                books.admitted.push_back(message);
            } else {
                books.waiting.push_back(message);
            }
        }
        let taken = SENT + admitted + waiting;
        books.last_id = Some(10 * taken as u64 + 1);
        books.counters.delivered = (SENT - sent.len()) as u64;
        books.counters.offered = taken as u64;
        books.invariants();
        Self {
            books,
            outstanding,
            admitted,
            waiting,
            pooled,
        }
    }
}

/// DAT-REFS: RELEASE is accepted exactly if all messages that it names are outstanding, in
/// ascending order. If it is accepted, exactly these messages are settled once and their slots are
/// free. Otherwise nothing changes.
//= SM2-MSG-003, SM2-MSG-004, SM2-QOS-006 kani
// Shows DAT-REFS (Samples), bound: one step from any state of 3 sent and 2 queued messages; lists of up to 3.
#[cfg_attr(kani, kani::proof)]
// At most seven messages; trees of at most three entries; lists of at most three numbers.
#[cfg_attr(kani, kani::unwind(10))]
fn release_is_exact() {
    // Whether the link displaces messages makes no difference here.
    let mut state = State::with(kani::any(), one_of(&QUEUED), kani::any(), true);
    let before = state.books.clone();
    let base = before.sequence - SENT as u64;
    // Numbers from one before the oldest message to one after the last.
    let count = below(4);
    let mut named = [0; 3];
    let mut bytes = [0; 24];
    for (at, number) in named.iter_mut().enumerate().take(count) {
        *number = below(5);
        let sequence = base.saturating_add(*number as u64);
        bytes[8 * at..8 * at + 8].copy_from_slice(&sequence.to_le_bytes());
    }
    let named = &named[..count];
    let given = one_of(&[Given::Consumed, Given::Discarded, Given::Expired]);
    let frame = Frame::Release {
        given,
        count: count as u16,
        rest: &bytes[..8 * count],
    };
    // No number follows the largest sequence number.
    kani::assume(before.sequence < u64::MAX || named.iter().all(|number| *number <= SENT));
    let is_outstanding =
        |number: &usize| (1..=SENT).contains(number) && state.outstanding[number - 1];
    let ascends = named.windows(2).all(|pair| pair[0] < pair[1]);
    let legal = count > 0 && ascends && named.iter().all(is_outstanding);
    let mut settled = Vec::new();
    let verdict = state
        .books
        .release(&frame, given, |it| settled.push((it.key, it.id, it.fate)));
    kani::cover!(legal && count == 3, "three at once");
    kani::cover!(
        !legal && ascends && count == 2,
        "one of two was released before"
    );
    if !legal {
        assert_eq!(verdict, Err(violation!(BadRelease, "SM2-MSG-004")));
        assert!(state.books == before && settled.is_empty());
        return;
    }
    assert_eq!(verdict, Ok(()));
    let fate = match given {
        Given::Consumed => Fate::Delivered,
        Given::Discarded => Fate::Discarded,
        Given::Expired => Fate::Expired,
    };
    let of = |number: &usize| (10 * *number as u64, 10 * *number as u64 + 1, fate);
    assert!(named.iter().map(of).eq(settled));
    let (was, is) = (before.counters(), state.books.counters());
    assert_eq!(was.in_flight, is.in_flight + count as u64);
    let released = is.delivered + is.discarded + is.expired;
    let released = released - was.delivered - was.discarded - was.expired;
    assert_eq!(released, count as u64);
    for number in named {
        assert!(
            !state
                .books
                .unreleased
                .contains_key(&(base + *number as u64))
        );
        if state.pooled {
            let free = state.books.attachments.check(&SEGMENT, *number as u32);
            assert_eq!(free, Ok(()));
        }
    }
    assert!(!state.books.owes());
    state.books.invariants();
}

/// No other message may use a slot that holds a message of this link, whether the message waits, is
/// admitted or is outstanding.
//= SM2-PAY-005, SM2-MSG-003 kani
// Shows DAT-REFS (Exhaustive), bound: any state of 3 sent and 2 queued messages.
#[cfg_attr(kani, kani::proof)]
#[cfg_attr(kani, kani::unwind(10))]
fn outstanding_slots_are_not_used_again() {
    let outstanding: [bool; SENT] = kani::any();
    let (admitted, waiting) = one_of(&QUEUED);
    let state = State::with(outstanding, (admitted, waiting), true, kani::any());
    let number = 1 + below(7);
    let taken = if number <= SENT {
        outstanding[number - 1]
    } else {
        number <= SENT + admitted + waiting
    };
    let next = OutboundMessage {
        id: 100,
        ..message(number, true)
    };
    let expected = if taken { Err(Misuse::SlotBusy) } else { Ok(()) };
    assert_eq!(state.books.check(&next), expected);
    kani::cover!(taken && number <= SENT, "outstanding");
    kani::cover!(taken && number > SENT + admitted, "waiting");
    kani::cover!(!taken && number <= SENT, "released");
}

/// A message is sent with the next sequence number and within the window. After the largest
/// sequence number, no message is sent.
//= SM2-MSG-001, SM2-MSG-003, SM2-SEG-003 kani
// Shows LNK-ORDER (Exhaustive), bound: one step from any state of 3 sent and 2 queued messages; counts beyond 32 bits
// and at 2^64 - 1.
#[cfg_attr(kani, kani::proof)]
#[cfg_attr(kani, kani::unwind(10))]
fn sent_messages_are_numbered() {
    let mut state = State::any();
    let last = state.books.sequence;
    let used = state.books.unreleased.len();
    let kind = |packet: &Packet| FrameKind::from_number(packet.head[0]);
    let first = state.books.poll();
    let attaches = state.admitted > 0 && state.pooled && used == 0;
    let sent = if attaches {
        let attach = first.expect("a frame");
        assert!(kind(&attach.packet) == Some(FrameKind::Attach) && attach.id.is_none());
        assert!(
            state.books.unreleased.is_empty(),
            "nothing is sent before it"
        );
        state.books.poll()
    } else {
        first
    };
    kani::cover!(
        attaches && sent.is_some(),
        "ATTACH before the first message"
    );
    kani::cover!(last == u64::MAX && state.admitted > 0, "no number is left");
    if state.admitted == 0 || last == u64::MAX {
        assert!(sent.is_none());
        assert_eq!(state.books.sequence, last);
    } else {
        let sent = sent.expect("a message");
        assert!(kind(&sent.packet) == Some(FrameKind::Data));
        assert_eq!(sent.packet.head[16..24], (last + 1).to_le_bytes());
        assert_eq!(sent.id, Some(10 * (SENT as u64 + 1) + 1));
        assert_eq!(state.books.sequence, last + 1);
        assert_eq!(state.books.unreleased.len(), used + 1);
    }
    assert!(state.books.unreleased.len() <= state.books.window);
    state.books.invariants();
}

/// One more message finds room, displaces the oldest waiting message, or is refused. OPEN and an
/// expired deadline also keep the state consistent.
//= SM2-QOS-001, SM2-QOS-002, SM2-QOS-006, SM2-OPN-003 kani
// Shows LNK-QUEUE (Exhaustive), bound: one step from any state of 3 sent and 2 queued messages.
#[cfg_attr(kani, kani::proof)]
#[cfg_attr(kani, kani::unwind(10))]
fn one_more_message_keeps_the_books() {
    let mut state = State::any();
    let before = state.books.counters();
    let room =
        state.waiting < 2 || state.books.unreleased.len() + state.admitted < state.books.window;
    let reliable = !state.books.displaces;
    assert_eq!(state.books.has_room(), room);
    match below(3) {
        0 => {
            let taken = SENT + state.admitted + state.waiting;
            let next = message(taken + 1, state.pooled);
            assert_eq!(state.books.check(&next), Ok(()));
            let verdict = state.books.send(next);
            let after = state.books.counters();
            if room {
                assert_eq!(verdict, Ok(None));
                assert_eq!(after.in_flight, before.in_flight + 1);
            } else if reliable {
                assert_eq!(verdict, Err(Misuse::NoRoom));
                assert_eq!(after, before);
            } else {
                let oldest = 10 * (SENT + state.admitted + 1) as u64;
                assert_eq!(verdict, Ok(Some(oldest)));
                assert_eq!(after.overwritten, before.overwritten + 1);
                assert_eq!(after.in_flight, before.in_flight);
                kani::cover!(state.pooled, "a slot is free again");
            }
            kani::cover!(!room && reliable, "no room");
        }
        1 => {
            let verdict = state.books.drop_publication(Fate::NoRoom);
            assert_eq!(verdict.is_ok(), !room);
            assert_eq!(state.books.owes(), !room);
            let after = state.books.counters();
            assert_eq!(after.no_room, before.no_room + u64::from(!room));
        }
        _ => {
            // OPEN comes once, before any message was sent.
            kani::assume(state.books.window == 0);
            let window = below(4);
            let is_accepted = kani::any();
            let mut dropped = 0;
            (state.books.waiting.iter_mut()).for_each(|it| it.len = 1);
            let max_len = if is_accepted { 1 } else { 0 };
            state.books.open(window as u32, max_len, |_| dropped += 1);
            let waiting = if is_accepted { state.waiting } else { 0 };
            assert_eq!(dropped, state.waiting - waiting);
            assert_eq!(state.books.admitted.len(), window.min(waiting));
            let after = state.books.counters();
            assert_eq!(after.too_long, before.too_long + dropped as u64);
            assert_eq!(after.in_flight, before.in_flight - dropped as u64);
            kani::cover!(dropped == 2 && state.pooled, "two slots are free again");
            kani::cover!(window == 1 && state.waiting == 2, "one of two is admitted");
        }
    }
    state.books.invariants();
}

/// The end settles each unsettled message once, the oldest first.
//= SM2-OPN-009, SM2-QOS-006 kani
// Shows LNK-QUEUE (Exhaustive), bound: one step from any state of 3 sent and 2 queued messages.
#[cfg_attr(kani, kani::proof)]
#[cfg_attr(kani, kani::unwind(10))]
fn the_end_settles_all() {
    let mut state = State::any();
    let before = state.books.counters();
    let mut keys = Vec::new();
    state.books.end(|key| keys.push(key));
    let of = |number: usize| 10 * number as u64;
    let sent = (1..=SENT).filter(|number| state.outstanding[number - 1]);
    let behind = SENT + 1..=SENT + state.admitted + state.waiting;
    assert!(sent.chain(behind).map(of).eq(keys));
    let after = state.books.counters();
    assert_eq!(after.closed, before.closed + before.in_flight);
    assert_eq!(after.in_flight, 0);
    assert_eq!(after.offered, before.offered);
    assert!(state.books.attachments.check(&SEGMENT, 1).is_ok());
    state.books.invariants();
    kani::cover!(before.in_flight == 5, "all that there can be");
}

#[cfg(test)]
kani::explored! {
    release_is_exact: 2,
    outstanding_slots_are_not_used_again: 3,
    sent_messages_are_numbered: 2,
    one_more_message_keeps_the_books: 4,
    the_end_settles_all: 1,
}
