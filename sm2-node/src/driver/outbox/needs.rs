//! The forms of messages that links accept.

use sm2_proto::link::Placement;

/// The forms of messages that the links of an interface accept.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct Needs {
    /// Some links accept messages only in slots, however short they are.
    pub(crate) slot: bool,
    /// Some links accept short messages inline and others in slots.
    pub(crate) pooled: bool,
    /// Some links accept short messages inline and others in files of their own.
    pub(crate) sealed: bool,
}

impl From<Placement> for Needs {
    fn from(placement: Placement) -> Self {
        Self {
            slot: placement == Placement::Slot,
            pooled: placement == Placement::InlineOrSlot,
            sealed: placement == Placement::InlineOrSealed,
        }
    }
}

impl Needs {
    /// The needs of a link whose lane is not known yet. If the link turns out to accept only slots,
    /// the message is copied to a slot later.
    pub(crate) const fn of(sealed: bool) -> Self {
        Self {
            slot: false,
            pooled: !sealed,
            sealed,
        }
    }

    pub(crate) const fn nobody(self) -> bool {
        !self.slot && !self.pooled && !self.sealed
    }

    /// Whether some links take a short message inline.
    pub(crate) const fn inline(self) -> bool {
        self.pooled || self.sealed
    }

    /// Adds the needs of another link.
    pub(crate) const fn add(&mut self, other: Self) {
        self.slot |= other.slot;
        self.pooled |= other.pooled;
        self.sealed |= other.sealed;
    }
}
