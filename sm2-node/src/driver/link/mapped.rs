//! The memory of a link that both sides map. The driver lends this memory to the machine for each
//! call.

use std::os::fd::{AsFd, BorrowedFd, OwnedFd};
use std::sync::Arc;

use sm2_io::Ring;
use sm2_proto::limits::SLOT_HEAD;
use sm2_proto::link::{self, LinkMemory, SlotRange};

use crate::quota::MappedSegment;

/// The memory of a link that both sides map.
#[derive(Debug, Default)]
pub(super) struct Mapped {
    /// The ring that this side takes messages from.
    pub(super) incoming: Option<Ring>,
    /// The ring that this side sends through.
    pub(super) outgoing: Option<Ring>,
    /// The segments of the other side.
    pub(super) segments: Segments,
}

/// The ring for messages to this side, until the other side has its file.
#[derive(Debug, Default)]
pub(super) enum OwnRing {
    /// The other side has the file, or no ring is needed.
    #[default]
    Settled,
    /// Created before OPEN: both ends have not agreed on a lane yet.
    Prepared(Ring, OwnedFd),
    /// Agreed on, and not sent to the other side yet.
    Unsent(OwnedFd),
}

impl OwnRing {
    /// The file for RING.
    pub(super) fn file(&self) -> Option<BorrowedFd<'_>> {
        match self {
            Self::Unsent(file) => Some(file.as_fd()),
            Self::Settled | Self::Prepared(..) => None,
        }
    }
}

/// Mapped segments, ordered by number. Each message looks its segment up several times, and usually
/// there is one, which is found faster here than in a tree.
#[derive(Debug, Default)]
pub(super) struct Segments(Vec<(u32, Arc<MappedSegment>)>);

impl Segments {
    #[inline]
    pub(super) fn get(&self, segment: u32) -> Option<&Arc<MappedSegment>> {
        match self.0.as_slice() {
            [(only, mapping)] if *only == segment => Some(mapping),
            all => Some(&all.get(self.place(segment).ok()?)?.1),
        }
    }

    pub(super) fn insert(&mut self, segment: u32, mapping: Arc<MappedSegment>) {
        match self.place(segment) {
            Ok(place) => self.0[place].1 = mapping,
            Err(place) => self.0.insert(place, (segment, mapping)),
        }
    }

    pub(super) fn remove(&mut self, segment: u32) {
        if let Ok(place) = self.place(segment) {
            self.0.remove(place);
        }
    }

    pub(super) fn clear(&mut self) {
        self.0.clear();
    }

    fn place(&self, segment: u32) -> Result<usize, usize> {
        self.0.binary_search_by_key(&segment, |it| it.0)
    }
}

impl LinkMemory for Mapped {
    type Ring = Ring;

    #[inline]
    fn outgoing(&self) -> Option<&Ring> {
        self.outgoing.as_ref()
    }

    #[inline]
    fn incoming(&self) -> Option<&Ring> {
        self.incoming.as_ref()
    }

    #[inline]
    fn slot_head(&self, slot: SlotRange) -> Option<[u8; SLOT_HEAD]> {
        let segment = self.segments.get(slot.segment)?;
        segment.copy::<SLOT_HEAD>(slot.head_offset())
    }
}

/// Creates the ring from which this side will take messages, before this side offers the ring lane.
/// A process without a free descriptor uses the socket lane.
//= SM2-RNG-002
pub(super) fn prepare_ring(config: &mut link::Config) -> OwnRing {
    let layout = config
        .ring_layout()
        .filter(|_| config.ring && !config.sealed);
    let Some(layout) = layout else {
        return OwnRing::Settled;
    };
    match Ring::create(layout) {
        Ok((ring, file)) => OwnRing::Prepared(ring, file),
        Err(error) => {
            tracing::debug!(link = %config.id, %error, "no ring: the socket lane is used");
            config.ring = false;
            OwnRing::Settled
        }
    }
}
