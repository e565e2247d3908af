//! Memory that is reserved before any message is sent.

use std::io;

use sm2_io::{Segment, Slot};

use crate::pool::{Full, Pool};

/// The reason why there is no slot.
#[derive(Debug)]
pub(crate) enum NoSlot {
    Full,
    Io(io::Error),
    /// The memory of the slot cannot be locked into RAM.
    Lock(io::Error),
}

/// How the memory of a segment is prepared when the segment is reserved.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct Reservation {
    /// All pages are present.
    pub(crate) prefault: bool,
    /// All pages are locked into RAM.
    pub(crate) lock: bool,
}

impl Reservation {
    pub(super) fn apply(self, segment: &mut Segment) -> Result<(), NoSlot> {
        if self.prefault {
            segment.prefault().map_err(NoSlot::Io)?;
        }
        if self.lock {
            segment.lock().map_err(NoSlot::Lock)?;
        }
        Ok(())
    }
}

/// Reserved memory for `slots` messages of up to `len` bytes each.
#[derive(Debug)]
pub(crate) struct Reserved {
    pub(super) segment: Segment,
    pub(super) len: u64,
    pub(super) slots: u32,
    pub(super) how: Reservation,
}

impl Reserved {
    pub(crate) fn new(len: u64, slots: u32, how: Reservation) -> Result<Self, NoSlot> {
        let plan = Pool::<Slot>::new(0).plan_reserved(len, slots);
        let geometry = plan.map_err(|Full| NoSlot::Full)?;
        let mut segment = Segment::create(geometry.stride, geometry.slots).map_err(NoSlot::Io)?;
        how.apply(&mut segment)?;
        Ok(Self {
            segment,
            len,
            slots,
            how,
        })
    }
}
