//! Lends rings and mapped segments to the machine of a link, for one call at a time.

use std::os::fd::OwnedFd;
use std::sync::Arc;

use sm2_io::Ring;
use sm2_proto::limits::SLOT_HEAD;
use sm2_proto::link::{self, LinkMemory, SlotRange};

use crate::driver::origin::LinkSegment;

/// The memory of a link that both sides map.
#[derive(Debug, Default)]
pub(super) struct Mapped {
    /// The ring that this side takes messages from.
    pub(super) incoming: Option<Arc<Ring>>,
    /// The ring that this side sends through.
    pub(super) outgoing: Option<Ring>,
    /// The segments of the other side.
    pub(super) segments: Segments,
}

/// Mapped segments, ordered by number. Each message looks its segment up several times, and usually
/// there is one, which is found faster here than in a tree.
#[derive(Debug, Default)]
pub(super) struct Segments(Vec<(u32, Arc<LinkSegment>)>);

impl Segments {
    #[inline]
    pub(super) fn get(&self, segment: u32) -> Option<&Arc<LinkSegment>> {
        match self.0.as_slice() {
            [(only, mapped)] if *only == segment => Some(mapped),
            all => Some(&all.get(self.place(segment).ok()?)?.1),
        }
    }

    pub(super) fn insert(&mut self, segment: u32, mapped: Arc<LinkSegment>) {
        match self.place(segment) {
            Ok(place) => self.0[place].1 = mapped,
            Err(place) => self.0.insert(place, (segment, mapped)),
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

    const PREFETCHES: bool = true;

    #[inline]
    fn outgoing(&self) -> Option<&Ring> {
        self.outgoing.as_ref()
    }

    #[inline]
    fn incoming(&self) -> Option<&Ring> {
        self.incoming.as_deref()
    }

    #[inline]
    fn slot_head(&self, slot: SlotRange) -> Option<[u8; SLOT_HEAD]> {
        let segment = self.segments.get(slot.segment)?;
        segment.mapping.copy::<SLOT_HEAD>(slot.head_offset())
    }

    #[inline]
    fn prefetch(&self, slot: SlotRange) {
        if let Some(segment) = self.segments.get(slot.segment) {
            segment.mapping.prefetch(slot.head_offset());
            segment.mapping.prefetch(slot.offset);
        }
    }
}

/// Creates the ring that this side will take messages from, before this side offers the ring lane. Returns the file
/// for RING. A process without a free descriptor offers the socket lane only.
//= SM2-RNG-002
pub(super) fn make_ring(config: &mut link::Config, mapped: &mut Mapped) -> Option<OwnedFd> {
    let layout = (config.ring_layout()).filter(|_| config.ring && !config.sealed)?;
    match Ring::create(layout) {
        Ok((ring, file)) => {
            mapped.incoming = Some(Arc::new(ring));
            Some(file)
        }
        Err(error) => {
            tracing::debug!(link = %config.id, %error, "no ring: the socket lane is used");
            config.ring = false;
            None
        }
    }
}
