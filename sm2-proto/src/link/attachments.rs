//! The segments of this end that the messages of a link use (the sending side of SPEC section 8.3).
//!
//! A segment is *named* while a message in one of its slots is not settled, and *attached* from
//! ATTACH to DETACH. At most 256 segments are named at a time. A segment that has to be attached is
//! named itself, so among 256 attached segments at most 255 hold unreleased messages, and one can
//! be detached.

#[cfg(any(kani, test))]
mod proofs;

use alloc::collections::{BTreeMap, BTreeSet, VecDeque};

use super::{
    Misuse, SegmentInfo,
    segments::{Geometry, SegmentFrame, Slot},
};
use crate::limits::SEGMENTS_MAX;

#[derive(Clone, Debug, Default, PartialEq, Eq, Hash)]
pub(super) struct Attachments {
    segments: BTreeMap<u32, OwnSegment>,
    /// The number of named segments.
    named: usize,
    /// The number of attached segments.
    attached: usize,
    /// The attached segments without unreleased messages, by the order of their ATTACH frames.
    idle: BTreeMap<u64, u32>,
    /// Those whose DETACH has not been sent yet.
    retired: VecDeque<u32>,
    /// The number of ATTACH frames so far.
    order: u64,
}

/// A segment that is named, attached, or both.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
struct OwnSegment {
    geometry: Geometry,
    /// The slots of messages that are not settled.
    slots: BTreeSet<u32>,
    /// How many of these messages were sent.
    unreleased: usize,
    /// The position of its ATTACH frame among all ATTACH frames, if the segment is attached.
    attached: Option<u64>,
}

impl Attachments {
    /// Checks whether a message may be put into this slot.
    pub(super) fn check(&self, info: &SegmentInfo, slot: u32) -> Result<(), Misuse> {
        let geometry = Geometry::new(info.stride, info.slots).ok_or(Misuse::BadSegment)?;
        if geometry.offset(slot).is_none() {
            return Err(Misuse::SlotOutside);
        }
        let segment = self.segments.get(&info.id);
        if segment.is_some_and(|segment| segment.geometry != geometry) {
            return Err(Misuse::SegmentChanged);
        }
        //= SM2-PAY-005
        if segment.is_some_and(|segment| segment.slots.contains(&slot)) {
            return Err(Misuse::SlotBusy);
        }
        let is_named = segment.is_some_and(|segment| !segment.slots.is_empty());
        if !is_named && self.named >= SEGMENTS_MAX {
            return Err(Misuse::SegmentLimit);
        }
        Ok(())
    }

    /// Records a message in this slot, which [`check`](Self::check) has allowed.
    pub(super) fn queue(&mut self, info: &SegmentInfo, slot: u32) {
        let Some(geometry) = Geometry::new(info.stride, info.slots) else {
            return;
        };
        let segment = self.segments.entry(info.id).or_insert(OwnSegment {
            geometry,
            slots: BTreeSet::new(),
            unreleased: 0,
            attached: None,
        });
        if segment.slots.is_empty() {
            self.named += 1;
        }
        segment.slots.insert(slot);
    }

    /// Returns the frame that has to be sent before a message in this segment; `None` if the
    /// message can be sent now. The caller sends the returned frame.
    //= SM2-SEG-004, SM2-SEG-005
    pub(super) fn prepare(&mut self, id: u32) -> Option<SegmentFrame> {
        let segment = self.segments.get_mut(&id)?;
        if segment.attached.is_some() {
            return None;
        }
        if self.attached >= SEGMENTS_MAX {
            let (_, oldest) = self.idle.pop_first()?;
            self.detach(oldest);
            return Some(SegmentFrame::Detach(oldest));
        }
        segment.attached = Some(self.order);
        let geometry = segment.geometry;
        let info = SegmentInfo {
            id,
            stride: geometry.stride(),
            slots: geometry.slots(),
        };
        self.idle.insert(self.order, id);
        self.attached += 1;
        self.order += 1;
        Some(SegmentFrame::Attach(info))
    }

    /// Records that the message in this slot was sent.
    pub(super) fn sent(&mut self, at: Slot) {
        if let Some(segment) = self.segments.get_mut(&at.segment) {
            segment.unreleased += 1;
            if let Some(order) = segment.attached {
                self.idle.remove(&order);
            }
        }
    }

    /// Records that the message in this slot is settled. `sent` says whether it had been sent.
    pub(super) fn settle(&mut self, at: Slot, sent: bool) {
        let Some(segment) = self.segments.get_mut(&at.segment) else {
            return;
        };
        segment.slots.remove(&at.slot);
        if segment.slots.is_empty() {
            self.named -= 1;
        }
        if sent {
            segment.unreleased -= 1;
        }
        match segment.attached {
            Some(order) if segment.unreleased == 0 => {
                self.idle.insert(order, at.segment);
            }
            None if segment.slots.is_empty() => {
                self.segments.remove(&at.segment);
            }
            _ => {}
        }
    }

    /// Called when the application will not use the segment again.
    pub(super) fn retire(&mut self, id: u32) -> Result<(), Misuse> {
        let Some(segment) = self.segments.get(&id) else {
            return Ok(());
        };
        if !segment.slots.is_empty() {
            return Err(Misuse::SegmentBusy);
        }
        if let Some(order) = segment.attached {
            self.idle.remove(&order);
            self.detach(id);
            self.retired.push_back(id);
        }
        Ok(())
    }

    /// Returns the next retired segment whose DETACH has to be sent.
    pub(super) fn poll_retired(&mut self) -> Option<u32> {
        self.retired.pop_front()
    }

    fn detach(&mut self, id: u32) {
        self.attached -= 1;
        if let Some(segment) = self.segments.get_mut(&id) {
            segment.attached = None;
            if segment.slots.is_empty() {
                self.segments.remove(&id);
            }
        }
    }

    /// Checks the invariants, which hold after each call.
    pub(super) fn invariants(&self) {
        let segments = self.segments.values();
        debug_assert_eq!(
            self.named,
            segments.clone().filter(|it| !it.slots.is_empty()).count()
        );
        debug_assert_eq!(
            self.attached,
            segments.clone().filter(|it| it.attached.is_some()).count()
        );
        debug_assert!(self.named <= SEGMENTS_MAX);
        debug_assert!(self.attached + self.retired.len() <= SEGMENTS_MAX);
        let is_idle = |it: &&OwnSegment| it.attached.is_some() && it.unreleased == 0;
        debug_assert_eq!(self.idle.len(), segments.clone().filter(is_idle).count());
        debug_assert!(segments.clone().all(|it| it.unreleased <= it.slots.len()));
        debug_assert!(
            segments
                .clone()
                .all(|it| it.attached.is_some() || !it.slots.is_empty())
        );
        debug_assert!(
            segments
                .clone()
                .all(|it| it.attached.is_some() || it.unreleased == 0)
        );
    }
}
