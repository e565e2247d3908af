//! The segments of the other end that the messages of a ring are in.

use alloc::collections::{BTreeMap, VecDeque};

use crate::{
    FdFacts, Violation,
    link::segments::{Geometry, SegmentInfo, check_attach},
};

/// The receiver's view of segments on the ring lane. The socket and the ring have no common order,
/// so a number is free again only when DETACHED has been sent.
#[derive(Clone, Debug, Default, PartialEq, Eq, Hash)]
pub(in crate::link) struct RingSegments {
    attached: BTreeMap<u32, Geometry>,
    /// Detached segments whose DETACHED has not been sent, the oldest first.
    leaving: VecDeque<u32>,
}

impl RingSegments {
    /// ATTACH came.
    //= SM2-SEG-001, SM2-SEG-003, SM2-SEG-004, SM2-RNG-010
    pub(in crate::link) fn attach(
        &mut self,
        info: &SegmentInfo,
        fds: &[FdFacts],
    ) -> Result<(), Violation> {
        let is_taken = self.attached.contains_key(&info.id) || self.leaving.contains(&info.id);
        let count = self.attached.len() + self.leaving.len();
        let geometry = check_attach(info, fds, is_taken, count)?;
        self.attached.insert(info.id, geometry);
        Ok(())
    }

    /// DETACH came.
    //= SM2-SEG-005, SM2-RNG-010
    pub(in crate::link) fn detach(&mut self, segment: u32) -> Result<(), Violation> {
        if self.attached.remove(&segment).is_none() {
            return Err(violation!(UnknownSegment, "SM2-SEG-005"));
        }
        self.leaving.push_back(segment);
        Ok(())
    }

    /// The geometry of an attached segment.
    #[inline]
    pub(in crate::link) fn geometry(&self, segment: u32) -> Option<Geometry> {
        self.attached.get(&segment).copied()
    }

    /// Whether DETACHED has to be sent for a segment.
    #[inline]
    pub(super) fn has_detached(&self) -> bool {
        !self.leaving.is_empty()
    }

    /// The next segment whose DETACHED has to be sent.
    pub(super) fn poll_detached(&mut self) -> Option<u32> {
        self.leaving.pop_front()
    }
}
