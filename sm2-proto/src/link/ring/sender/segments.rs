//! The segments that the sender of a ring has attached, and the unsettled message in each of their slots.

use alloc::{collections::VecDeque, vec, vec::Vec};
use core::num::NonZeroU64;

use super::super::super::{
    Misuse, SegmentInfo,
    segments::{Geometry, SegmentFrame},
};
use super::super::{RingMessage, Word};
use crate::{
    Violation,
    limits::{MESSAGE_MAX, RING_SEGMENTS_MAX, SEGMENTS_MAX, SLOT_HEAD},
};

/// The segments of a sender, and the frames that announce them.
#[derive(Clone, Debug, Default, PartialEq, Eq, Hash)]
pub(in crate::link) struct SenderSegments {
    /// Indexed by number.
    table: Vec<Option<SenderSegment>>,
    /// How many segment numbers are in use.
    attached: usize,
    /// The frames that have to be sent over the socket, the oldest first.
    steps: VecDeque<SegmentFrame>,
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
pub(super) struct Unsettled {
    pub(super) key: u64,
    /// From 1, so that no message takes no further space in the table.
    pub(super) sequence: NonZeroU64,
}

impl SenderSegments {
    /// Attaches the segment, unless it is attached. If 256 numbers are in use, an idle segment is
    /// detached instead, and the caller has to try again after DETACHED.
    //= SM2-RNG-003, SM2-RNG-009, SM2-SEG-004
    pub(in crate::link) fn attach(&mut self, info: &SegmentInfo) -> Result<(), Misuse> {
        if let Some(segment) = self.get(info.id) {
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
        if self.table.len() <= index {
            self.table.resize(index + 1, None);
        }
        if let Some(place) = self.table.get_mut(index) {
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
        let mut segments = self.table.iter().flatten();
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
        match self.get(id) {
            Some(segment) if segment.unreleased > 0 => Err(Misuse::SegmentBusy),
            Some(SenderSegment { state, .. }) if *state != State::Detaching => {
                self.start_detaching(id);
                Ok(())
            }
            _ => Ok(()),
        }
    }

    fn start_detaching(&mut self, id: u32) {
        if let Some(segment) = self.get_mut(id) {
            segment.state = State::Detaching;
            segment.slots = Vec::new();
            self.steps.push_back(SegmentFrame::Detach(id));
        }
    }

    /// Handles DETACHED.
    //= SM2-RNG-009
    pub(in crate::link) fn detached(&mut self, id: u32) -> Result<(), Violation> {
        let is_announced = !self.steps.contains(&SegmentFrame::Detach(id));
        match self.table.get_mut(id as usize) {
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
        (self.get(info.id)).is_some_and(|it| it.info == *info && it.state == State::Attached)
    }

    /// Whether a frame has to be sent over the socket.
    pub(in crate::link) fn has_steps(&self) -> bool {
        !self.steps.is_empty()
    }

    /// Returns the next frame that has to be sent over the socket. The caller sends it.
    pub(in crate::link) fn poll(&mut self) -> Option<SegmentFrame> {
        let step = self.steps.pop_front()?;
        if let SegmentFrame::Attach(info) = step
            && let Some(segment) = self.get_mut(info.id)
            && segment.state == State::Attaching
        {
            segment.state = State::Attached;
        }
        Some(step)
    }

    /// Checks whether a message may be sent in its slot. Returns its word.
    //= SM2-RNG-003, SM2-PAY-005, SM2-PAY-008
    #[inline]
    pub(super) fn check(&self, message: &RingMessage, sequence: u64) -> Result<Word, Misuse> {
        let RingMessage {
            segment: info,
            slot,
            ..
        } = message;
        let segment = self.get(info.id).ok_or(Misuse::NotAttached)?;
        if segment.state != State::Attached {
            return Err(Misuse::NotAttached);
        }
        if segment.info != *info {
            return Err(Misuse::SegmentChanged);
        }
        if message.len > MESSAGE_MAX.min(info.stride - SLOT_HEAD as u64) {
            return Err(Misuse::TooLong);
        }
        match segment.slots.get(*slot as usize) {
            None => return Err(Misuse::SlotOutside),
            Some(Some(_)) => return Err(Misuse::SlotBusy),
            Some(None) => {}
        }
        Word::new(info.id, *slot, sequence).ok_or(Misuse::SlotOutside)
    }

    /// Records a message that [`check`](Self::check) has allowed.
    #[inline]
    pub(super) fn enter(&mut self, message: &RingMessage, sequence: u64) {
        if let Some(segment) = self.get_mut(message.segment.id) {
            segment.unreleased += 1;
            if let Some(slot) = segment.slots.get_mut(message.slot as usize) {
                let key = message.key;
                *slot = NonZeroU64::new(sequence).map(|sequence| Unsettled { key, sequence });
            }
        }
    }

    /// Takes out the message in the slot of this word, if `is_it` accepts it.
    #[inline]
    pub(super) fn settle<R>(
        &mut self,
        word: Word,
        is_it: impl FnOnce(Unsettled) -> Option<R>,
    ) -> Option<R> {
        let segment = self.get_mut(u32::from(word.segment))?;
        let slot = segment.slots.get_mut(usize::from(word.slot))?;
        let result = is_it((*slot)?)?;
        *slot = None;
        segment.unreleased -= 1;
        Some(result)
    }

    /// The keys of the messages that are not settled.
    pub(super) fn keys(&self) -> impl Iterator<Item = u64> {
        let slots = self.table.iter().flatten().flat_map(|it| &it.slots);
        slots.flatten().map(|it| it.key)
    }

    /// Forgets all segments, with the end of the link.
    pub(super) fn clear(&mut self) {
        *self = Self::default();
    }

    /// Checks the invariants, and returns how many messages are not settled.
    pub(super) fn invariants(&self) -> u32 {
        let segments = self.table.iter().flatten();
        debug_assert_eq!(self.attached, segments.clone().count());
        segments.map(|it| it.unreleased).sum()
    }

    #[inline]
    fn get(&self, id: u32) -> Option<&SenderSegment> {
        self.table.get(id as usize)?.as_ref()
    }

    #[inline]
    fn get_mut(&mut self, id: u32) -> Option<&mut SenderSegment> {
        self.table.get_mut(id as usize)?.as_mut()
    }
}
