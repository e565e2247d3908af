//! Why a connection of gateways ended, and a stream: SPEC section 14.8.

use crate::{Code, Violation, code::codes};

codes! {
    /// A breach of SPEC by a peer: it ends the connection.
    PeerViolation {
        FrameTooLong = 16, "frame-too-long", "SM2-GWF-002";
        UnknownFrame = 19, "unknown-frame", "SM2-FRM-001";
        Malformed = 20, "malformed", "SM2-FRM-001";
        TrailingBytes = 21, "trailing-bytes", "SM2-FRM-001";
        NotCanonical = 22, "not-canonical", "SM2-FRM-002";
        BadName = 23, "bad-name", "SM2-NAM-001";
        BadQos = 24, "bad-qos", "SM2-GWO-002";
        BadLength = 69, "bad-length", "SM2-GWM-002";
        BadPath = 103, "bad-path", "SM2-GWO-003";
    }
}

impl From<Violation> for PeerViolation {
    /// Of the body of a frame.
    fn from(violation: Violation) -> Self {
        match violation {
            Violation::UnknownFrame => Self::UnknownFrame,
            Violation::TrailingBytes => Self::TrailingBytes,
            Violation::NotCanonical => Self::NotCanonical,
            Violation::BadName => Self::BadName,
            _ => Self::Malformed,
        }
    }
}

impl core::fmt::Display for PeerViolation {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        write!(f, "{} ({})", self.name(), self.clause())
    }
}

impl core::error::Error for PeerViolation {}
