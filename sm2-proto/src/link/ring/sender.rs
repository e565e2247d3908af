//! The sender's side of a ring: the words that it put, and the messages that are not settled.

#[cfg(any(kani, test))]
mod proofs;

use alloc::{collections::VecDeque, vec, vec::Vec};
use core::num::NonZeroU64;

use super::{
    super::{
        Counters, Fate, Misuse, SegmentInfo,
        debt::Debt,
        frame_kind::Carrier,
        segments::{Geometry, SegmentFrame},
    },
    At, EMPTY, RingLayout, RingMemory, Wake, Word,
    message::{RingMessage, RingSendError},
    wake_parked,
};
use crate::{
    Violation,
    limits::{MESSAGE_MAX, RING_DISPLACED_MAX, RING_SEGMENTS_MAX, SEGMENTS_MAX, SLOT_HEAD},
};

#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub(in crate::link) struct RingSender {
    layout: RingLayout,
    carrier: Carrier,
    /// Whether a message that was not taken is displaced by the message one round later.
    displaces: bool,
    /// Whether messages have a lifespan, so that the receiver can give them back as expired.
    expires: bool,
    /// The sequence number of the last message.
    sequence: u64,
    /// The word that this side last put at each index; [`EMPTY`] if it put none, or took the word
    /// out itself.
    forward: Vec<u64>,
    /// How many messages the receiver gave back.
    returned: u64,
    /// How many messages are not settled.
    unreleased: u32,
    /// The segments, indexed by number.
    segments: Vec<Option<SenderSegment>>,
    /// How many segment numbers are in use.
    attached: usize,
    /// The frames that have to be sent over the socket, the oldest first.
    steps: VecDeque<SegmentFrame>,
    last_id: Option<u64>,
    /// How many messages were displaced since the receiver last took one.
    displaced: u32,
    /// By sequence numbers.
    debt: Debt,
    /// Its `in_flight` is always zero: [`Self::counters`] computes the true value.
    counters: Counters,
}

/// A segment whose number is in use, because the other end may still use it.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
struct SenderSegment {
    info: SegmentInfo,
    state: State,
    unreleased: u32,
    /// The unsettled message in each slot.
    slots: Vec<Option<Unsettled>>,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
enum State {
    /// ATTACH has to be sent.
    Attaching,
    /// ATTACH was sent.
    Attached,
    /// DETACH has to be sent, or was sent and DETACHED has not come.
    Detaching,
}

/// A message that is not settled.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
struct Unsettled {
    key: u64,
    /// From 1, so that no message takes no further space in the table.
    sequence: NonZeroU64,
}

impl RingSender {
    pub(in crate::link) fn new(
        layout: RingLayout,
        carrier: Carrier,
        reliable: bool,
        expires: bool,
    ) -> Self {
        Self {
            layout,
            carrier,
            displaces: !reliable,
            expires,
            sequence: 0,
            forward: vec![EMPTY; usize::from(layout.depth())],
            returned: 0,
            unreleased: 0,
            segments: Vec::new(),
            attached: 0,
            steps: VecDeque::new(),
            last_id: None,
            displaced: 0,
            debt: Debt::default(),
            counters: Counters::default(),
        }
    }

    /// Attaches the segment, unless it is attached. If 256 numbers are in use, an idle segment is
    /// detached instead, and the caller has to try again after DETACHED.
    //= SM2-RNG-003, SM2-RNG-009, SM2-SEG-004
    pub(in crate::link) fn attach(&mut self, info: &SegmentInfo) -> Result<(), Misuse> {
        if let Some(segment) = self.segment(info.id) {
            if segment.info == *info && segment.state != State::Detaching {
                return Ok(());
            }
            return Err(match segment.state {
                State::Detaching => Misuse::SegmentBusy,
                State::Attaching | State::Attached => Misuse::SegmentChanged,
            });
        }
        Geometry::new(info.stride, info.slots).ok_or(Misuse::BadSegment)?;
        if info.id >= RING_SEGMENTS_MAX {
            return Err(Misuse::BadSegment);
        }
        if self.attached >= SEGMENTS_MAX {
            // Until DETACHED comes, messages in the new segment are refused.
            self.detach_idle();
            return Ok(());
        }
        let index = info.id as usize;
        if self.segments.len() <= index {
            self.segments.resize(index + 1, None);
        }
        if let Some(place) = self.segments.get_mut(index) {
            *place = Some(SenderSegment {
                info: *info,
                state: State::Attaching,
                unreleased: 0,
                slots: vec![None; info.slots as usize],
            });
            self.attached += 1;
            self.steps.push_back(SegmentFrame::Attach(*info));
        }
        Ok(())
    }

    /// Detaches an idle segment, unless one is being detached.
    fn detach_idle(&mut self) {
        let mut segments = self.segments.iter().flatten();
        if segments.clone().any(|it| it.state == State::Detaching) {
            return;
        }
        let idle = segments.find(|it| it.state == State::Attached && it.unreleased == 0);
        if let Some(id) = idle.map(|it| it.info.id) {
            self.start_detaching(id);
        }
    }

    /// Called when the application will not use this segment again.
    pub(in crate::link) fn retire(&mut self, id: u32) -> Result<(), Misuse> {
        match self.segment(id) {
            Some(segment) if segment.unreleased > 0 => Err(Misuse::SegmentBusy),
            Some(SenderSegment { state, .. }) if *state != State::Detaching => {
                self.start_detaching(id);
                Ok(())
            }
            _ => Ok(()),
        }
    }

    fn start_detaching(&mut self, id: u32) {
        if let Some(segment) = self.segment_mut(id) {
            segment.state = State::Detaching;
            segment.slots = Vec::new();
            self.steps.push_back(SegmentFrame::Detach(id));
        }
    }

    /// Handles DETACHED.
    //= SM2-RNG-009
    pub(in crate::link) fn detached(&mut self, id: u32) -> Result<(), Violation> {
        let is_announced = !self.steps.contains(&SegmentFrame::Detach(id));
        match self.segments.get_mut(id as usize) {
            Some(place)
                if is_announced
                    && place
                        .as_ref()
                        .is_some_and(|it| it.state == State::Detaching) =>
            {
                *place = None;
                self.attached -= 1;
                Ok(())
            }
            _ => Err(violation!(UnknownSegment, "SM2-RNG-009")),
        }
    }

    /// Whether messages in this segment can be sent.
    pub(in crate::link) fn is_attached(&self, info: &SegmentInfo) -> bool {
        (self.segment(info.id)).is_some_and(|it| it.info == *info && it.state == State::Attached)
    }

    /// Whether a frame has to be sent over the socket.
    pub(in crate::link) fn has_steps(&self) -> bool {
        !self.steps.is_empty()
    }

    /// Returns the next frame that has to be sent over the socket. The caller sends it.
    pub(in crate::link) fn poll(&mut self) -> Option<SegmentFrame> {
        let step = self.steps.pop_front()?;
        if let SegmentFrame::Attach(info) = step
            && let Some(segment) = self.segment_mut(info.id)
            && segment.state == State::Attaching
        {
            segment.state = State::Attached;
        }
        Some(step)
    }

    /// Whether one more message could be sent without displacing another and without being refused.
    #[inline]
    pub(in crate::link) fn has_room(&self, words: &impl RingMemory) -> bool {
        // A receiver takes messages in order, before it gives them back. So if fewer are unreleased than the ring has
        // words, it has taken the one in the next word, and the line of that word, which it writes, stays with it.
        self.unreleased < u32::from(self.layout.depth())
            || self.unreleased < self.layout.window()
                && words.load(self.layout.forward(self.sequence + 1)) == EMPTY
    }

    /// Puts a message into the ring. Returns whether the receiver has to be woken.
    //= SM2-RNG-005, SM2-RNG-010
    pub(in crate::link) fn send(
        &mut self,
        words: &impl RingMemory,
        message: &RingMessage,
        settled: &mut impl FnMut(u64, Fate),
    ) -> Result<Wake, RingSendError> {
        let sequence = self.sequence + 1;
        let word = self.check(message, sequence)?;
        if !self.displaces && !self.has_room(words) {
            return Err(Misuse::NoRoom.into());
        }
        let at = self.layout.forward(sequence);
        let room = self.make_room(words, at, settled);
        // From here on the message is settled like any other, whatever the receiver does.
        self.enter(message, sequence);
        room?;
        self.put(words, at, word.to_bits(), settled)?;
        if self.displaced >= RING_DISPLACED_MAX {
            return Err(RingSendError::Stopped);
        }
        Ok(wake_parked(words, At::ReceiverParked))
    }

    /// If the window is full, takes the oldest message out of the ring and settles the messages
    /// that came back.
    //= SM2-RNG-006
    fn make_room(
        &mut self,
        words: &impl RingMemory,
        at: At,
        settled: &mut impl FnMut(u64, Fate),
    ) -> Result<(), Violation> {
        if self.unreleased < self.layout.window() {
            return Ok(());
        }
        self.put(words, at, EMPTY, settled)?;
        self.harvest(words, settled)?;
        if self.unreleased >= self.layout.window() {
            return Err(violation!(WindowExceeded, "SM2-RNG-006"));
        }
        Ok(())
    }

    /// Records a message that [`check`](Self::check) has allowed.
    #[inline]
    fn enter(&mut self, message: &RingMessage, sequence: u64) {
        self.sequence = sequence;
        self.last_id = Some(message.id);
        self.counters.offered += 1;
        self.unreleased += 1;
        if let Some(segment) = self.segment_mut(message.segment.id) {
            segment.unreleased += 1;
            if let Some(slot) = segment.slots.get_mut(message.slot as usize) {
                let key = message.key;
                *slot = NonZeroU64::new(sequence).map(|sequence| Unsettled { key, sequence });
            }
        }
    }

    /// Checks whether the message may be sent. Returns its word.
    //= SM2-RNG-003, SM2-PAY-005, SM2-PAY-008
    #[inline]
    fn check(&self, message: &RingMessage, sequence: u64) -> Result<Word, Misuse> {
        let RingMessage {
            segment: info,
            slot,
            ..
        } = message;
        let segment = self.segment(info.id).ok_or(Misuse::NotAttached)?;
        if segment.state != State::Attached {
            return Err(Misuse::NotAttached);
        }
        if segment.info != *info {
            return Err(Misuse::SegmentChanged);
        }
        if message.len > MESSAGE_MAX.min(info.stride - SLOT_HEAD as u64) {
            return Err(Misuse::TooLong);
        }
        if self.carrier != Carrier::Reply && message.id <= self.last_id.unwrap_or(0) {
            return Err(Misuse::IdNotGrowing);
        }
        match segment.slots.get(*slot as usize) {
            None => return Err(Misuse::SlotOutside),
            Some(Some(_)) => return Err(Misuse::SlotBusy),
            Some(None) => {}
        }
        Word::new(info.id, *slot, sequence).ok_or(Misuse::SlotOutside)
    }

    /// Puts a word at an index and settles the message that it displaced.
    //= SM2-RNG-005, SM2-QOS-001
    fn put(
        &mut self,
        words: &impl RingMemory,
        at: At,
        bits: u64,
        settled: &mut impl FnMut(u64, Fate),
    ) -> Result<(), Violation> {
        let At::Forward(index) = at else {
            return Ok(());
        };
        let Some(ours) = self.forward.get_mut(index as usize) else {
            return Ok(());
        };
        let put = core::mem::replace(ours, bits);
        let was = words.swap(at, bits);
        if was == EMPTY {
            // If this side took the word out itself, the empty word does not show that the receiver
            // took a message.
            if put != EMPTY {
                self.displaced = 0;
            }
            return Ok(());
        }
        if was != put || !self.displaces {
            return Err(violation!(BadWord, "SM2-RNG-005"));
        }
        // `settle` fails if this message was already given back, so no message is counted twice.
        let displaced = self.settle(put);
        let (key, _) = displaced.ok_or(violation!(BadWord, "SM2-RNG-005"))?;
        self.displaced = self.displaced.saturating_add(1);
        self.counters.discarded += 1;
        settled(key, Fate::Discarded);
        Ok(())
    }

    /// Settles the messages that the receiver gave back.
    //= SM2-RNG-008
    pub(in crate::link) fn harvest(
        &mut self,
        words: &impl RingMemory,
        settled: &mut impl FnMut(u64, Fate),
    ) -> Result<(), Violation> {
        for _ in 0..self.layout.window() {
            let at = self.layout.back_word(self.returned);
            if words.load(at) == EMPTY {
                break;
            }
            let bits = words.swap(at, EMPTY);
            self.returned += 1;
            let back = self.settle(bits);
            let (key, fate) = back.ok_or(violation!(BadWord, "SM2-RNG-008"))?;
            *self.counters.of_mut(fate) += 1;
            settled(key, fate);
        }
        Ok(())
    }

    /// Settles the message that these bits name, and returns its key and whether it was delivered or
    /// has expired. `None` if they name no unsettled message.
    //= SM2-RNG-008
    #[inline]
    fn settle(&mut self, bits: u64) -> Option<(u64, Fate)> {
        let word = Word::from_bits(bits).ok()??;
        let expires = self.expires;
        let segment = self.segment_mut(u32::from(word.segment))?;
        let slot = segment.slots.get_mut(usize::from(word.slot))?;
        let Unsettled { key, sequence } = (*slot)?;
        let sequence = sequence.get();
        let fate = if sequence as u32 == word.sequence {
            Fate::Delivered
        } else if expires && sequence as u32 == !word.sequence {
            Fate::Expired
        } else {
            return None;
        };
        *slot = None;
        segment.unreleased -= 1;
        self.unreleased -= 1;
        self.debt.settle(sequence);
        Some((key, fate))
    }

    /// Counts a publication that is not sent on this link.
    //= SM2-QOS-008, SM2-QOS-010, SM2-QOS-002, SM2-QOS-003, SM2-QOS-007
    pub(in crate::link) const fn drop_publication(&mut self, fate: Fate) {
        self.counters.drop_publication(fate);
        if fate.incurs_debt() {
            self.debt.incur(self.sequence, self.unreleased as u64);
        }
    }

    /// Counts a queued message that is not sent, because the link is over.
    //= SM2-OPN-009
    pub(super) const fn count_closed(&mut self) {
        self.counters.drop_publication(Fate::Closed);
    }

    /// Ends the sender's side with the link. Passes the keys of all messages that were not settled
    /// to `each`.
    //= SM2-OPN-009
    pub(in crate::link) fn end(&mut self, mut each: impl FnMut(u64)) {
        let slots = self.segments.drain(..).flatten().flat_map(|it| it.slots);
        for sent in slots.flatten() {
            each(sent.key);
        }
        self.counters.closed += u64::from(self.unreleased);
        self.unreleased = 0;
        self.attached = 0;
        self.steps.clear();
        self.debt.clear();
    }

    #[inline]
    pub(in crate::link) const fn owes(&self) -> bool {
        self.debt.is_owed()
    }

    /// The keys of the messages that are not settled.
    pub(in crate::link) fn keys(&self) -> impl Iterator<Item = u64> {
        let slots = self.segments.iter().flatten().flat_map(|it| &it.slots);
        let unsettled = slots.flatten().map(|it| it.key);
        unsettled.take(self.unreleased as usize)
    }

    pub(in crate::link) const fn in_flight(&self) -> usize {
        self.unreleased as usize
    }

    //= SM2-QOS-006
    #[inline]
    pub(in crate::link) fn counters(&self) -> Counters {
        Counters {
            in_flight: u64::from(self.unreleased),
            ..self.counters
        }
    }

    #[inline]
    fn segment(&self, id: u32) -> Option<&SenderSegment> {
        self.segments.get(id as usize)?.as_ref()
    }

    #[inline]
    fn segment_mut(&mut self, id: u32) -> Option<&mut SenderSegment> {
        self.segments.get_mut(id as usize)?.as_mut()
    }

    /// Checks the invariants, which hold after each call.
    #[inline]
    pub(in crate::link) fn invariants(&self) {
        if cfg!(debug_assertions) {
            let it = self.counters();
            debug_assert!(it.is_balanced(), "{it:?}");
            debug_assert!(self.debt.left() <= it.in_flight);
            let segments = self.segments.iter().flatten();
            debug_assert_eq!(self.attached, segments.clone().count());
            let unreleased: u32 = segments.map(|it| it.unreleased).sum();
            debug_assert_eq!(unreleased, self.unreleased);
            debug_assert!(self.unreleased <= self.layout.window());
        }
    }
}
