//! Why a connection of gateways ended, and a stream: SPEC section 14.8.

use crate::{Violation, ViolationKind, code::codes};

codes! {
    /// A breach of SPEC by a peer: it ends the connection.
    PeerViolation {
        FrameTooLong = 16, "frame-too-long", "SM2-GWF-002";
        UnknownFrame = 19, "unknown-frame", "SM2-FRM-001";
        Malformed = 20, "malformed", "SM2-FRM-001";
        TrailingBytes = 21, "trailing-bytes", "SM2-FRM-001";
        NotCanonical = 22, "not-canonical", "SM2-FRM-002";
        BadName = 23, "bad-name", "SM2-NAM-001";
        BadQos = 24, "bad-qos", "SM2-GWO-006";
        ExpectedHello = 32, "expected-hello", "SM2-GWF-001";
        UnexpectedHello = 33, "unexpected-hello", "SM2-GWF-001";
        BadVersionRange = 34, "bad-version-range", "SM2-GWF-001";
        BadLength = 69, "bad-length", "SM2-GWM-002";
        UnknownCall = 86, "unknown-call", "SM2-GWS-002";
        BadOffer = 99, "bad-offer", "SM2-GWO-001";
        OfferLimit = 100, "offer-limit", "SM2-GWO-001";
        UnknownOffer = 101, "unknown-offer", "SM2-GWO-002";
        BadWant = 102, "bad-want", "SM2-GWO-002";
        BadPath = 103, "bad-path", "SM2-GWO-003";
        UnexpectedAnswer = 104, "unexpected-answer", "SM2-GWO-005";
        NotWanted = 105, "not-wanted", "SM2-GWM-001";
    }
}

codes! {
    /// An end of a connection that is nobody's breach of SPEC.
    PeerFarewell {
        Done = 0, "done", "SM2-GWE-001";
        GreetingTimeout = 1, "greeting-timeout", "SM2-GWF-001";
        Stalled = 2, "stalled", "SM2-GWF-003";
        ShuttingDown = 3, "shutting-down", "SM2-GWE-001";
        Resources = 4, "resources", "SM2-GWE-001";
        Duplicate = 96, "duplicate", "SM2-GWC-004";
        Stale = 97, "stale", "SM2-GWC-004";
        Version = 98, "version", "SM2-GWF-001";
    }
}

codes! {
    /// Why a stream was reset, or is not read any more.
    StreamEnd {
        Superseded = 112, "superseded", "SM2-GWM-004";
        Expired = 113, "expired", "SM2-GWM-004";
        Withdrawn = 114, "withdrawn", "SM2-GWM-004";
        Cancelled = 115, "cancelled", "SM2-GWS-003";
    }
}

impl From<Violation> for PeerViolation {
    /// Of the body of a frame.
    fn from(violation: Violation) -> Self {
        match violation.kind() {
            ViolationKind::UnknownFrame => Self::UnknownFrame,
            ViolationKind::TrailingBytes => Self::TrailingBytes,
            ViolationKind::NotCanonical => Self::NotCanonical,
            ViolationKind::BadName => Self::BadName,
            _ => Self::Malformed,
        }
    }
}

impl core::error::Error for PeerViolation {}
