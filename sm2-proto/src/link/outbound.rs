//! The sending side of the socket lane: SPEC section 8 as the sender sees it.
//!
//! A message is *waiting* while the window does not admit it, *admitted* until it is sent, and then
//! *unreleased* until RELEASE names it. Only waiting messages count against `depth` and can be
//! displaced.

#[cfg(any(kani, test))]
mod proofs;

use alloc::collections::{BTreeMap, VecDeque};
use core::mem;

use bytes::Bytes;

use super::{
    Attachment, Body, Carrier, Config, Counters, Fate, Misuse, OutboundMessage, Packet, Role,
    SegmentInfo, Status,
    attachments::Attachments,
    debt::Debt,
    segments::{SegmentFrame, Slot, is_legal_len},
    wire::{Form, Frame, Given, MessageFrame},
};
use crate::{
    Instant, Period, Violation,
    limits::{CALLS_MAX, INLINE_MAX, RELEASE_MAX},
};

#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub(super) struct Outbound {
    carrier: Carrier,
    /// Whether a waiting message in excess of `depth` displaces the oldest one.
    displaces: bool,
    /// Whether pooled messages are illegal.
    sealed: bool,
    lifespan: Period,
    /// How many messages may wait.
    depth: usize,
    /// How many messages may be admitted or unreleased. Zero until OPEN comes.
    window: usize,
    waiting: VecDeque<OutboundMessage>,
    admitted: VecDeque<OutboundMessage>,
    unreleased: BTreeMap<u64, Unreleased>,
    attachments: Attachments,
    /// The sequence number of the last message that was sent.
    sequence: u64,
    /// The id of the last message that was accepted for sending.
    last_id: Option<u64>,
    /// By the ids of messages.
    debt: Debt,
    /// Its `in_flight` is always zero: [`Self::counters`] computes the true value.
    counters: Counters,
}

/// The record of a message that was sent and not released.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
struct Unreleased {
    key: u64,
    id: u64,
    slot: Option<Slot>,
}

/// A message that the other end has released.
pub(super) struct Released {
    pub(super) key: u64,
    pub(super) id: u64,
    pub(super) fate: Fate,
}

/// A frame that [`Outbound::poll`] sends.
pub(super) struct OutboundFrame {
    pub(super) packet: Packet,
    /// The id of the message, if the packet carries a message.
    pub(super) id: Option<u64>,
}

impl Outbound {
    pub(super) fn new(config: &Config) -> Self {
        let (carrier, depth) = match config.role {
            Role::Sender | Role::Receiver => (Carrier::Data, usize::from(config.depth)),
            // The limit of calls bounds the queue, so no reply is ever refused.
            Role::Caller => (Carrier::Request, CALLS_MAX),
            Role::Server => (Carrier::Reply, CALLS_MAX),
        };
        Self {
            carrier,
            displaces: !config.reliable,
            sealed: config.sealed,
            lifespan: config.lifespan,
            depth,
            window: 0,
            waiting: VecDeque::new(),
            admitted: VecDeque::new(),
            unreleased: BTreeMap::new(),
            attachments: Attachments::default(),
            sequence: 0,
            last_id: None,
            debt: Debt::default(),
            counters: Counters::default(),
        }
    }

    /// Handles OPEN with the other end's window and maximum length of a message. Passes each queued
    /// message that is longer to `dropped`.
    //= SM2-QOS-008
    pub(super) fn open(
        &mut self,
        window: u32,
        max_len: u64,
        mut dropped: impl FnMut(&OutboundMessage),
    ) {
        let mut too_long = VecDeque::new();
        // Nothing is admitted before OPEN.
        for message in mem::take(&mut self.waiting) {
            match message.len > max_len {
                true => too_long.push_back(message),
                false => self.waiting.push_back(message),
            }
        }
        for message in too_long {
            self.counters.too_long += 1;
            self.settle(message.id, slot_of(&message.body), false);
            dropped(&message);
        }
        self.window = window as usize;
        self.admit();
    }

    /// Checks whether the message may be sent.
    pub(super) fn check(&self, message: &OutboundMessage) -> Result<(), Misuse> {
        let is_reply = self.carrier == Carrier::Reply;
        if (!is_reply && message.status != Status::Ok)
            || (!message.status.has_payload() && message.len != 0)
        {
            return Err(Misuse::Status);
        }
        if !is_reply && message.id <= self.last_id.unwrap_or(0) {
            return Err(Misuse::IdNotGrowing);
        }
        if !is_legal_len(message.len) {
            return Err(Misuse::TooLong);
        }
        match &message.body {
            Body::Inline(bytes) if bytes.len() as u64 != message.len => Err(Misuse::Length),
            Body::Inline(bytes) if bytes.len() > INLINE_MAX => Err(Misuse::TooLong),
            Body::Pooled { .. } if self.sealed => Err(Misuse::NotSealed),
            Body::Pooled { segment, slot } => {
                self.attachments.check(segment, *slot)?;
                if message.len > segment.stride {
                    Err(Misuse::TooLong)
                } else {
                    Ok(())
                }
            }
            Body::Inline(_) | Body::Sealed => Ok(()),
        }
    }

    /// Accepts a message that [`check`](Self::check) has allowed. Returns the key of the message
    /// that it displaced, if any.
    //= SM2-QOS-001, SM2-QOS-002
    pub(super) fn send(&mut self, message: OutboundMessage) -> Result<Option<u64>, Misuse> {
        let displaced = if self.has_room() {
            None
        } else if self.displaces {
            self.waiting.pop_front()
        } else {
            return Err(Misuse::NoRoom);
        };
        if let Some(displaced) = &displaced {
            self.counters.overwritten += 1;
            self.settle(displaced.id, slot_of(&displaced.body), false);
        }
        self.counters.offered += 1;
        if self.carrier != Carrier::Reply {
            self.last_id = Some(message.id);
        }
        if let Body::Pooled { segment, slot } = &message.body {
            self.attachments.queue(segment, *slot);
        }
        self.waiting.push_back(message);
        self.admit();
        Ok(displaced.map(|displaced| displaced.key))
    }

    /// Counts a publication that is not sent on this link.
    //= SM2-QOS-008, SM2-QOS-010, SM2-QOS-002, SM2-QOS-003, SM2-QOS-007
    pub(super) fn drop_publication(&mut self, fate: Fate) -> Result<(), Misuse> {
        if fate == Fate::NoRoom && self.has_room() {
            return Err(Misuse::RoomLeft);
        }
        self.counters.drop_publication(fate);
        if fate.incurs_debt() {
            let in_flight = self.in_flight() as u64;
            self.debt.incur(self.last_id.unwrap_or(0), in_flight);
        }
        Ok(())
    }

    /// Drops the messages that were not sent and are older than their lifespan. Passes their keys to `each`.
    //= SM2-QOS-010
    pub(super) fn expire(&mut self, now: Instant, mut each: impl FnMut(u64)) {
        let lifespan = self.lifespan;
        let is_over = |it: Option<&OutboundMessage>| {
            it.is_some_and(|message| lifespan.has_passed(message.time, now))
        };
        loop {
            // The admitted messages are older than those that wait.
            let message = if is_over(self.admitted.front()) {
                self.admitted.pop_front()
            } else if self.admitted.is_empty() && is_over(self.waiting.front()) {
                self.waiting.pop_front()
            } else {
                None
            };
            let Some(message) = message else { break };
            self.counters.expired += 1;
            self.settle(message.id, slot_of(&message.body), false);
            each(message.key);
            self.admit();
        }
    }

    /// Moves waiting messages to the admitted ones while the window has room.
    //= SM2-MSG-003
    fn admit(&mut self) {
        while self.admitted.len() + self.unreleased.len() < self.window {
            let Some(message) = self.waiting.pop_front() else {
                break;
            };
            self.admitted.push_back(message);
        }
    }

    /// Handles RELEASE. If any of its numbers is illegal, none of them has an effect.
    //= SM2-MSG-004
    pub(super) fn release(
        &mut self,
        frame: &Frame<'_>,
        given: Given,
        mut each: impl FnMut(Released),
    ) -> Result<(), Violation> {
        //= SM2-QOS-010
        if given == Given::Expired && self.lifespan == Period::NONE {
            return Err(violation!(BadRelease, "SM2-QOS-010"));
        }
        let mut count = 0;
        let mut last = 0;
        for sequence in frame.sequences() {
            count += 1;
            if sequence <= last || count > RELEASE_MAX || !self.unreleased.contains_key(&sequence) {
                return Err(violation!(BadRelease, "SM2-MSG-004"));
            }
            last = sequence;
        }
        if count == 0 {
            return Err(violation!(BadRelease, "SM2-MSG-004"));
        }
        for sequence in frame.sequences() {
            if let Some(released) = self.take_unreleased(sequence, given) {
                each(released);
            }
        }
        self.admit();
        Ok(())
    }

    //= SM2-QOS-006
    fn take_unreleased(&mut self, sequence: u64, given: Given) -> Option<Released> {
        let Unreleased { key, id, slot } = self.unreleased.remove(&sequence)?;
        self.settle(id, slot, true);
        let fate = match given {
            Given::Consumed => Fate::Delivered,
            Given::Discarded => Fate::Discarded,
            Given::Expired => Fate::Expired,
        };
        *self.counters.of_mut(fate) += 1;
        Some(Released { key, id, fate })
    }

    fn settle(&mut self, id: u64, slot: Option<Slot>, sent: bool) {
        self.debt.settle(id);
        if let Some(slot) = slot {
            self.attachments.settle(slot, sent);
        }
    }

    /// Called when the application will not use this segment again.
    pub(super) fn retire(&mut self, segment: u32) -> Result<(), Misuse> {
        self.attachments.retire(segment)
    }

    /// Returns the next frame to send: DETACH, ATTACH or a message.
    pub(super) fn poll(&mut self) -> Option<OutboundFrame> {
        if let Some(segment) = self.attachments.poll_retired() {
            return Some(OutboundFrame::bare(&Frame::Detach { segment }));
        }
        let message = self.admitted.front()?;
        if let Body::Pooled { segment, .. } = &message.body {
            match self.attachments.prepare(segment.id) {
                Some(SegmentFrame::Detach(segment)) => {
                    return Some(OutboundFrame::bare(&Frame::Detach { segment }));
                }
                Some(SegmentFrame::Attach(segment)) => return Some(OutboundFrame::attach(segment)),
                None => {}
            }
        }
        self.send_admitted()
    }

    //= SM2-MSG-001
    fn send_admitted(&mut self) -> Option<OutboundFrame> {
        let sequence = self.sequence.checked_add(1)?;
        let message = self.admitted.pop_front()?;
        self.sequence = sequence;
        let slot = slot_of(&message.body);
        if let Some(slot) = slot {
            self.attachments.sent(slot);
        }
        self.unreleased.insert(
            sequence,
            Unreleased {
                key: message.key,
                id: message.id,
                slot,
            },
        );
        Some(OutboundFrame {
            id: Some(message.id),
            packet: packet(self.carrier, sequence, message),
        })
    }

    /// Ends this side with the link: all messages count as given back. Passes the keys of all
    /// messages that were not settled to `each`, the oldest first.
    //= SM2-OPN-009
    pub(super) fn end(&mut self, mut each: impl FnMut(u64)) {
        let before = self.counters();
        self.counters = Counters {
            closed: before.closed + before.in_flight,
            in_flight: 0,
            ..before
        };
        let sent = mem::take(&mut self.unreleased)
            .into_values()
            .map(|sent| sent.key);
        let admitted = self.admitted.drain(..).map(|message| message.key);
        let waiting = self.waiting.drain(..).map(|message| message.key);
        sent.chain(admitted).chain(waiting).for_each(&mut each);
        self.attachments = Attachments::default();
        self.debt.clear();
    }

    /// Whether one more message could be sent without displacing another and without being refused.
    pub(super) fn has_room(&self) -> bool {
        // Nothing waits while the window has room.
        self.waiting.len() < self.depth
    }

    /// Whether messages wait for the window.
    pub(super) fn has_queued(&self) -> bool {
        !self.waiting.is_empty()
    }

    pub(super) const fn owes(&self) -> bool {
        self.debt.is_owed()
    }

    /// The id of the last message that was accepted for sending.
    pub(super) const fn last_id(&self) -> Option<u64> {
        self.last_id
    }

    /// The keys of the messages that are not settled.
    pub(super) fn keys(&self) -> impl Iterator<Item = u64> {
        let sent = self.unreleased.values().map(|it| it.key);
        let unsent = self.admitted.iter().chain(&self.waiting);
        sent.chain(unsent.map(|it| it.key))
    }

    pub(super) fn in_flight(&self) -> usize {
        self.waiting.len() + self.admitted.len() + self.unreleased.len()
    }

    //= SM2-QOS-006
    pub(super) fn counters(&self) -> Counters {
        Counters {
            in_flight: self.in_flight() as u64,
            ..self.counters
        }
    }

    /// Checks the invariants, which hold after each call.
    pub(super) fn invariants(&self) {
        let it = self.counters();
        debug_assert!(it.is_balanced(), "{it:?}");
        debug_assert!(self.waiting.len() <= self.depth);
        debug_assert!(self.debt.left() <= it.in_flight);
        let used = self.admitted.len() + self.unreleased.len();
        debug_assert!(used <= self.window);
        debug_assert!(self.waiting.is_empty() || used == self.window);
        self.attachments.invariants();
    }
}

impl OutboundFrame {
    fn bare(frame: &Frame<'_>) -> Self {
        Self {
            packet: Packet::bare(frame.head()),
            id: None,
        }
    }

    fn attach(segment: SegmentInfo) -> Self {
        let head = Frame::Attach(segment).head();
        let attachment = Some(Attachment::Segment(segment.id));
        Self {
            packet: Packet {
                attachment,
                ..Packet::bare(head)
            },
            id: None,
        }
    }
}

fn slot_of(body: &Body) -> Option<Slot> {
    match body {
        Body::Pooled { segment, slot } => Some(Slot {
            segment: segment.id,
            slot: *slot,
        }),
        Body::Inline(_) | Body::Sealed => None,
    }
}

/// Builds the frame of a message.
//= SM2-MSG-002, SM2-PAY-002, SM2-PAY-003, SM2-PAY-004
fn packet(carrier: Carrier, sequence: u64, message: OutboundMessage) -> Packet {
    let OutboundMessage {
        key,
        id,
        time,
        status,
        len,
        body,
    } = message;
    let (form, payload, attachment) = match body {
        Body::Inline(bytes) => (Form::Inline, bytes, None),
        Body::Pooled { segment, slot } => (
            Form::Pooled {
                segment: segment.id,
                slot,
            },
            Bytes::new(),
            None,
        ),
        Body::Sealed => (Form::Sealed, Bytes::new(), Some(Attachment::Message(key))),
    };
    let frame = MessageFrame {
        carrier,
        form,
        status,
        sequence,
        id,
        time,
        len,
        rest: &[],
    };
    Packet {
        head: Frame::Message(frame).head(),
        payload,
        attachment,
    }
}
