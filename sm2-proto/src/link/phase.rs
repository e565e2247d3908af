//! The frames that are legal in each phase, for each role: SPEC section 6 and the table of
//! section 7.
//!
//! This module decides only about the lifecycle and the kinds of frames, so that a proof can
//! enumerate all its inputs. Other modules check the contents of a legal frame.

use super::{FrameKind, Role};
use crate::Violation;

/// The phase of a link that is not over.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub(super) enum Phase {
    /// The other end's OPEN has not come yet.
    Opening,
    /// The other end's OPEN has come.
    Open,
}

/// Checks whether a frame of this kind is legal now. `ring` says whether the link uses the ring lane or, for RING,
/// whether the other end offers it.
//= SM2-OPN-001, SM2-WIR-002, SM2-RNG-001
pub(super) const fn check_kind(
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
