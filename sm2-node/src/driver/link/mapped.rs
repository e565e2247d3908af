//! The memory of a link that both sides map. The driver lends this memory to the machine for each
//! call.

use std::collections::BTreeMap;
use std::os::fd::OwnedFd;
use std::sync::Arc;

use sm2_io::{PooledMapping, Ring};
use sm2_proto::limits::SLOT_HEAD;
use sm2_proto::link::{self, LinkMemory, SlotRange};

/// The memory of a link that both sides map.
#[derive(Debug, Default)]
pub(super) struct Mapped {
    /// The ring that this side takes messages from.
    pub(super) incoming: Option<Ring>,
    /// The ring that this side sends through.
    pub(super) outgoing: Option<Ring>,
    /// The segments of the other side.
    pub(super) segments: BTreeMap<u32, Arc<PooledMapping>>,
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
        let segment = self.segments.get(&slot.segment)?;
        segment.copy::<SLOT_HEAD>(slot.head_offset())
    }
}

/// Creates the ring from which this side will take messages, before this side offers the ring lane.
/// A process without a free descriptor uses the socket lane.
//= SM2-RNG-002
pub(super) fn prepare_ring(config: &mut link::Config) -> Option<(Ring, OwnedFd)> {
    if !config.ring || config.sealed {
        return None;
    }
    let layout = config.ring_layout()?;
    match Ring::create(layout) {
        Ok(made) => Some(made),
        Err(error) => {
            tracing::debug!(link = %config.id, %error, "no ring: the socket lane is used");
            config.ring = false;
            None
        }
    }
}
