//! The segments of the other end that hold the messages of a ring.

use alloc::{collections::VecDeque, vec::Vec};

use crate::{
    FdFacts, Violation,
    limits::RING_SEGMENTS_MAX,
    link::segments::{Geometry, SegmentInfo, check_attach},
};

/// The receiver's view of segments on the ring lane. Frames and words have no common order, so a
/// segment's number is free again only after DETACHED was sent.
#[derive(Clone, Debug, Default, PartialEq, Eq, Hash)]
pub(in crate::link) struct RingSegments {
    /// Ordered by number. Usually there is one, which is found faster here than in a tree.
    attached: Vec<(u32, Geometry)>,
    /// Detached segments whose DETACHED was not sent yet, the oldest first.
    leaving: VecDeque<u32>,
}

impl RingSegments {
    /// Handles ATTACH.
    //= SM2-SEG-001, SM2-SEG-003, SM2-SEG-004, SM2-RNG-003, SM2-RNG-009
    pub(in crate::link) fn attach(
        &mut self,
        info: &SegmentInfo,
        fds: &[FdFacts],
    ) -> Result<(), Violation> {
        let place = self.place(info.id);
        let is_taken = place.is_ok() || self.leaving.contains(&info.id);
        let count = self.attached.len() + self.leaving.len();
        let geometry = check_attach(info, fds, is_taken, count)?;
        if info.id >= RING_SEGMENTS_MAX {
            return Err(violation!(BadSegment, "SM2-RNG-003"));
        }
        if let Err(place) = place {
            self.attached.insert(place, (info.id, geometry));
        }
        Ok(())
    }

    /// Handles DETACH.
    //= SM2-SEG-005, SM2-RNG-009
    pub(in crate::link) fn detach(&mut self, segment: u32) -> Result<(), Violation> {
        let place = self.place(segment);
        let place = place.map_err(|_| violation!(UnknownSegment, "SM2-SEG-005"))?;
        self.attached.remove(place);
        self.leaving.push_back(segment);
        Ok(())
    }

    /// The geometry of an attached segment.
    #[inline]
    pub(in crate::link) fn geometry(&self, segment: u32) -> Option<Geometry> {
        let place = self.place(segment).ok()?;
        Some(self.attached.get(place)?.1)
    }

    /// The index of a segment, or the index where it would be inserted.
    #[inline]
    fn place(&self, segment: u32) -> Result<usize, usize> {
        match self.attached.as_slice() {
            [(only, _)] if *only == segment => Ok(0),
            attached => attached.binary_search_by_key(&segment, |it| it.0),
        }
    }

    /// Whether DETACHED has to be sent for a segment.
    #[inline]
    pub(super) fn has_detached(&self) -> bool {
        !self.leaving.is_empty()
    }

    /// Returns the next segment that needs a DETACHED.
    pub(super) fn poll_detached(&mut self) -> Option<u32> {
        self.leaving.pop_front()
    }
}
