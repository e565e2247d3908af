//! The segments of one's own that the messages of a link use (the sending
//! side of SPEC section 8.3).
//!
//! A segment is *named* as long as a message of the link that is not settled
//! is in one of its slots, and *attached* from ATTACH to DETACH. No more than
//! 256 are named at a time, so a segment that has to be attached always finds
//! one to detach: among 256 attached ones at most 255 hold unreleased messages.

#[cfg(any(kani, test))]
mod proofs;

use alloc::collections::{BTreeMap, BTreeSet, VecDeque};

use super::{
    Misuse, SegmentInfo,
    segments::{Geometry, Slot},
};
use crate::limits::SEGMENTS_MAX;

#[derive(Clone, Debug, Default, PartialEq, Eq, Hash)]
pub(super) struct Attachments {
    segments: BTreeMap<u32, Segment>,
    /// How many segments are named.
    named: usize,
    /// How many segments are attached.
    attached: usize,
    /// The attached ones without unreleased messages, the longest attached first.
    idle: BTreeMap<u64, u32>,
    /// Those whose DETACH has not been sent yet.
    retired: VecDeque<u32>,
    /// Counts the ATTACH frames.
    order: u64,
}

/// A segment that is named, attached, or both.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
struct Segment {
    geometry: Geometry,
    /// The slots that messages not yet settled are in.
    slots: BTreeSet<u32>,
    /// How many of these messages are sent.
    unreleased: usize,
    /// Which ATTACH it was, if the segment is attached.
    attached: Option<u64>,
}

/// What has to be sent before a message can.
pub(super) enum Step {
    Detach(u32),
    Attach(SegmentInfo),
}

impl Attachments {
    /// Whether a message may be put in this slot.
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

    /// A message was put in this slot; `check` has allowed it.
    pub(super) fn queue(&mut self, info: &SegmentInfo, slot: u32) {
        let Some(geometry) = Geometry::new(info.stride, info.slots) else {
            return;
        };
        let segment = self.segments.entry(info.id).or_insert(Segment {
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

    /// What has to be sent first, so that a message in this segment can be;
    /// none if it can be sent now. The caller sends what it is given.
    //= SM2-SEG-004, SM2-SEG-005
    pub(super) fn prepare(&mut self, id: u32) -> Option<Step> {
        let segment = self.segments.get_mut(&id)?;
        if segment.attached.is_some() {
            return None;
        }
        if self.attached >= SEGMENTS_MAX {
            let (_, oldest) = self.idle.pop_first()?;
            self.detach(oldest);
            return Some(Step::Detach(oldest));
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
        Some(Step::Attach(info))
    }

    /// The message in this slot is sent.
    pub(super) fn sent(&mut self, at: Slot) {
        if let Some(segment) = self.segments.get_mut(&at.segment) {
            segment.unreleased += 1;
            if let Some(order) = segment.attached {
                self.idle.remove(&order);
            }
        }
    }

    /// The message in this slot is settled; whether it had been sent.
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

    /// The application will not use the segment again.
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

    /// The next retired segment whose DETACH has to be sent.
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

    /// What must hold between any two calls.
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
        let is_idle = |it: &&Segment| it.attached.is_some() && it.unreleased == 0;
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
