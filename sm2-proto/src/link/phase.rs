//! Which frames are legal when, and for whom: SPEC section 6 and the table of
//! section 7, as tables.
//!
//! Only the lifecycle and the kinds of frames are decided here, on values that
//! can be counted through; what a legal frame says is for the others.

use super::{FrameKind, Role};
use crate::Violation;

/// Where a link stands as long as it is not over.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub(super) enum Phase {
    /// The other end's OPEN has not come yet.
    Opening,
    /// It has.
    Open,
}

/// Whether a frame of this kind may come now, on a link with or without a ring.
//= SM2-OPN-001, SM2-WIR-002, SM2-RNG-001
pub(super) const fn admit(
    phase: Phase,
    role: Role,
    ring: bool,
    kind: FrameKind,
) -> Result<(), Violation> {
    match (phase, kind) {
        (Phase::Opening, FrameKind::Open) | (_, FrameKind::Close) => Ok(()),
        (Phase::Opening, _) => Err(violation!(ExpectedOpen, "SM2-OPN-001")),
        (Phase::Open, FrameKind::Open) => Err(violation!(UnexpectedOpen, "SM2-OPN-001")),
        (Phase::Open, kind) if !kind.is_received_by(role) => {
            Err(violation!(WrongRole, "SM2-WIR-002"))
        }
        (Phase::Open, kind) if !kind.is_on(ring) => Err(violation!(WrongLane, "SM2-RNG-001")),
        (Phase::Open, _) => Ok(()),
    }
}
