//! The receiving side of the socket lane: SPEC section 8 as the receiver sees it.
//!
//! A message is *ready* until the application takes it, and *borrowed* until the application gives
//! it back. It then waits for the RELEASE that names it. In all these states the message is
//! unreleased: it counts against the window and occupies its slot.

#[cfg(any(kani, test))]
mod proofs;

use alloc::{
    collections::{BTreeMap, BTreeSet, VecDeque},
    vec::Vec,
};

use core::convert::Infallible;

use bytes::Bytes;

use super::{
    Carrier, Config, Delivery, Packet, Payload, SegmentInfo, TooManyBorrowed,
    segments::{Geometry, Slot, Verified, check_attach, is_legal_len},
    wire::{Form, Frame, Given, MessageFrame},
};
use crate::{
    FdFacts, Instant, Newest, Violation,
    limits::{INLINE_MAX, RELEASE_MAX, SEGMENTS_MAX},
};

#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub(super) struct Inbound {
    /// Whether a ready message in excess of `depth` displaces the oldest one.
    displaces: bool,
    /// Whether segments and pooled messages are illegal.
    sealed: bool,
    depth: usize,
    max_borrowed: u16,
    /// The length of the longest message that this end accepts, in bytes.
    max_len: u64,
    window: usize,
    /// The sequence number of the last message that came.
    sequence: u64,
    /// The id of the last DATA that came.
    last_id: Option<u64>,
    /// The time of the last DATA that came.
    last_time: Option<Instant>,
    /// The id that the next DATA for the application has if no publication is lost.
    next_id: Option<u64>,
    segments: BTreeMap<u32, PeerSegment>,
    ready: VecDeque<Ready>,
    /// The messages of this and the following maps, by sequence number.
    borrowed: BTreeMap<u64, Option<Slot>>,
    consumed: BTreeMap<u64, Option<Slot>>,
    discarded: BTreeMap<u64, Option<Slot>>,
    expired: BTreeMap<u64, Option<Slot>>,
}

/// A segment of the other end.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
struct PeerSegment {
    geometry: Geometry,
    /// The slots that unreleased messages occupy.
    busy: BTreeSet<u32>,
}

#[derive(Clone, Debug, PartialEq, Eq, Hash)]
struct Ready {
    delivery: Delivery<Infallible>,
    slot: Option<Slot>,
}

/// A message that SPEC section 8 allows now. Only [`Inbound::check`] constructs it, and only
/// [`Inbound::accept`] consumes it.
pub(super) struct CheckedMessage {
    ready: Ready,
    carrier: Carrier,
}

impl CheckedMessage {
    /// Whether the descriptor of the datagram belongs to the message.
    pub(super) const fn is_sealed(&self) -> bool {
        matches!(self.ready.delivery.payload, Payload::Sealed)
    }

    /// The sequence number of the message.
    pub(super) const fn sequence(&self) -> u64 {
        self.ready.delivery.sequence
    }
}

impl Inbound {
    pub(super) const fn new(config: &Config) -> Self {
        Self {
            displaces: !config.reliable,
            sealed: config.sealed,
            depth: config.depth as usize,
            max_borrowed: config.max_borrowed,
            max_len: config.max_len.bytes(),
            window: config.window() as usize,
            sequence: 0,
            last_id: None,
            last_time: None,
            next_id: None,
            segments: BTreeMap::new(),
            ready: VecDeque::new(),
            borrowed: BTreeMap::new(),
            consumed: BTreeMap::new(),
            discarded: BTreeMap::new(),
            expired: BTreeMap::new(),
        }
    }

    /// Handles ATTACH.
    //= SM2-PAY-001, SM2-SEG-001, SM2-SEG-003, SM2-SEG-004
    pub(super) fn attach(&mut self, info: &SegmentInfo, fds: &[FdFacts]) -> Result<(), Violation> {
        self.check_pooled()?;
        let is_taken = self.segments.contains_key(&info.id);
        let geometry = check_attach(info, fds, is_taken, self.segments.len())?;
        self.segments.insert(
            info.id,
            PeerSegment {
                geometry,
                busy: BTreeSet::new(),
            },
        );
        Ok(())
    }

    /// Handles DETACH.
    //= SM2-SEG-005
    pub(super) fn detach(&mut self, segment: u32) -> Result<(), Violation> {
        let attached = self
            .segments
            .get(&segment)
            .ok_or(violation!(UnknownSegment, "SM2-SEG-005"))?;
        if !attached.busy.is_empty() {
            return Err(violation!(SegmentBusy, "SM2-SEG-005"));
        }
        self.segments.remove(&segment);
        Ok(())
    }

    /// Checks whether a message is legal now, by the clauses of SPEC section 8 in their order.
    pub(super) fn check(
        &self,
        message: &MessageFrame<'_>,
        fds: &[FdFacts],
    ) -> Result<CheckedMessage, Violation> {
        self.check_flow(message)?;
        let (payload, slot) = self.check_form(message)?;
        if !is_legal_len(message.len) {
            return Err(violation!(BadLength, "SM2-PAY-008"));
        }
        //= SM2-PAY-010
        if message.len > self.max_len {
            return Err(violation!(MessageTooLong, "SM2-PAY-010"));
        }
        if message.form == Form::Sealed {
            let verified =
                Verified::sealed(fds.first().ok_or(violation!(FdCount, "SM2-TRN-010"))?)?;
            verified.check_message(message.len)?;
        }
        let MessageFrame {
            carrier,
            status,
            sequence,
            id,
            time,
            len,
            ..
        } = *message;
        let delivery = Delivery {
            sequence,
            id,
            time,
            status,
            lost: 0,
            len,
            payload,
        };
        Ok(CheckedMessage {
            ready: Ready { delivery, slot },
            carrier,
        })
    }

    //= SM2-MSG-001, SM2-MSG-002, SM2-MSG-003
    fn check_flow(&self, message: &MessageFrame<'_>) -> Result<(), Violation> {
        if self.sequence.checked_add(1) != Some(message.sequence) {
            return Err(violation!(BadSequence, "SM2-MSG-001"));
        }
        // `calls.rs` checks the ids of calls.
        let is_data = message.carrier == Carrier::Data;
        if is_data && message.id <= self.last_id.unwrap_or(0) {
            return Err(violation!(BadId, "SM2-MSG-002"));
        }
        if self.unreleased() >= self.window {
            return Err(violation!(WindowExceeded, "SM2-MSG-003"));
        }
        Ok(())
    }

    fn check_form<C>(
        &self,
        message: &MessageFrame<'_>,
    ) -> Result<(Payload<C>, Option<Slot>), Violation> {
        match message.form {
            //= SM2-PAY-002
            Form::Inline if message.len > INLINE_MAX as u64 => {
                Err(violation!(BadLength, "SM2-PAY-002"))
            }
            Form::Inline => Ok((Payload::Inline(Bytes::copy_from_slice(message.rest)), None)),
            Form::Pooled { segment, slot } => {
                let offset = self.check_slot(segment, slot, message.len)?;
                Ok((
                    Payload::Pooled { segment, offset },
                    Some(Slot { segment, slot }),
                ))
            }
            //= SM2-PAY-004
            Form::Sealed => Ok((Payload::Sealed, None)),
        }
    }

    /// Whether the link may have segments and pooled messages.
    //= SM2-PAY-001
    const fn check_pooled(&self) -> Result<(), Violation> {
        if self.sealed {
            return Err(violation!(NotSealed, "SM2-PAY-001"));
        }
        Ok(())
    }

    /// Returns the offset of the payload of a pooled message.
    //= SM2-PAY-003, SM2-PAY-005
    fn check_slot(&self, segment: u32, slot: u32, len: u64) -> Result<u64, Violation> {
        self.check_pooled()?;
        let segment = self
            .segments
            .get(&segment)
            .ok_or(violation!(UnknownSegment, "SM2-PAY-003"))?;
        let offset = segment
            .geometry
            .offset(slot)
            .ok_or(violation!(BadSlot, "SM2-PAY-003"))?;
        if len > segment.geometry.stride() {
            return Err(violation!(BadLength, "SM2-PAY-003"));
        }
        if segment.busy.contains(&slot) {
            return Err(violation!(SlotBusy, "SM2-PAY-005"));
        }
        Ok(offset)
    }

    /// Accepts a message. Returns the sequence number of the message that it displaced, if any.
    //= SM2-QOS-001, SM2-QOS-002
    pub(super) fn accept(&mut self, checked: CheckedMessage) -> Option<u64> {
        let CheckedMessage { ready, carrier } = checked;
        self.sequence = ready.delivery.sequence;
        if carrier == Carrier::Data {
            self.last_id = Some(ready.delivery.id);
            self.last_time = Some(ready.delivery.time);
            self.next_id.get_or_insert(ready.delivery.id);
        }
        if let Some(Slot { segment, slot }) = ready.slot
            && let Some(segment) = self.segments.get_mut(&segment)
        {
            segment.busy.insert(slot);
        }
        self.ready.push_back(ready);
        if !self.displaces || self.ready.len() <= self.depth {
            return None;
        }
        let oldest = self.ready.pop_front()?;
        self.discarded.insert(oldest.delivery.sequence, oldest.slot);
        Some(oldest.delivery.sequence)
    }

    /// Takes the oldest ready message for the application.
    //= SM2-MSG-005
    pub(super) fn take(&mut self) -> Result<Option<Delivery<Infallible>>, TooManyBorrowed> {
        let max_borrowed = self.max_borrowed;
        if self.ready.is_empty() {
            return Ok(None);
        }
        if self.borrowed.len() >= usize::from(max_borrowed) {
            return Err(TooManyBorrowed { max_borrowed });
        }
        let Some(Ready { mut delivery, slot }) = self.ready.pop_front() else {
            return Ok(None);
        };
        if let Some(next_id) = &mut self.next_id {
            delivery.lost = delivery.id.saturating_sub(*next_id);
            *next_id = delivery.id.saturating_add(1);
        }
        self.borrowed.insert(delivery.sequence, slot);
        Ok(Some(delivery))
    }

    /// Gives back a message that the application took. Returns whether the application held it.
    //= SM2-QOS-010
    pub(super) fn release(&mut self, sequence: u64, given: Given) -> bool {
        let Some(slot) = self.borrowed.remove(&sequence) else {
            return false;
        };
        let pending = match given {
            Given::Consumed => &mut self.consumed,
            Given::Discarded => &mut self.discarded,
            Given::Expired => &mut self.expired,
        };
        pending.insert(sequence, slot);
        true
    }

    /// Returns the next RELEASE to send.
    //= SM2-MSG-004, SM2-MSG-005
    pub(super) fn poll(&mut self) -> Option<Packet> {
        let (given, pending) = if !self.discarded.is_empty() {
            (Given::Discarded, &mut self.discarded)
        } else if !self.expired.is_empty() {
            (Given::Expired, &mut self.expired)
        } else {
            (Given::Consumed, &mut self.consumed)
        };
        let count = pending.len().min(RELEASE_MAX) as u16;
        if count == 0 {
            return None;
        }
        let mut head = Frame::Release {
            given,
            count,
            rest: &[],
        }
        .head();
        let mut list = Vec::new();
        for _ in 0..count {
            let Some((sequence, slot)) = pending.pop_first() else {
                break;
            };
            if !head.push(sequence.to_le_bytes()) {
                list.extend_from_slice(&sequence.to_le_bytes());
            }
            if let Some(Slot { segment, slot }) = slot
                && let Some(segment) = self.segments.get_mut(&segment)
            {
                segment.busy.remove(&slot);
            }
        }
        Some(Packet {
            payload: list.into(),
            ..Packet::bare(head)
        })
    }

    /// Ends this side with the link. Ready messages stay valid; all others count as given back.
    //= SM2-OPN-007, SM2-OPN-009
    pub(super) fn end(&mut self) {
        self.consumed.clear();
        self.discarded.clear();
        self.expired.clear();
        self.segments.clear();
    }

    /// Called when the application gave a message back after the end.
    pub(super) fn forget(&mut self, sequence: u64) {
        self.borrowed.remove(&sequence);
    }

    /// The newest message that came.
    pub(super) const fn newest(&self) -> Newest {
        Newest {
            sequence: self.sequence,
            time: self.last_time,
        }
    }

    /// The number of messages that the application has not taken.
    #[inline]
    pub(super) fn untaken(&self) -> usize {
        self.ready.len()
    }

    fn unreleased(&self) -> usize {
        self.ready.len()
            + self.borrowed.len()
            + self.consumed.len()
            + self.discarded.len()
            + self.expired.len()
    }

    /// Checks the invariants, which hold after each call.
    pub(super) fn invariants(&self) {
        debug_assert!(self.unreleased() <= self.window);
        debug_assert!(!self.displaces || self.ready.len() <= self.depth);
        debug_assert!(self.borrowed.len() <= usize::from(self.max_borrowed));
        debug_assert!(self.segments.len() <= SEGMENTS_MAX);
        let all = [
            &self.borrowed,
            &self.consumed,
            &self.discarded,
            &self.expired,
        ];
        let slots = all.into_iter().flat_map(BTreeMap::values).flatten().count();
        let slots = slots + self.ready.iter().filter_map(|it| it.slot).count();
        let busy: usize = self.segments.values().map(|it| it.busy.len()).sum();
        debug_assert!(slots == busy || self.segments.is_empty());
    }
}
