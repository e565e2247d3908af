//! Codes that end connections between gateways and their streams: SPEC section 14.8.

use crate::{Violation, code::codes, control::DecodeError};

codes! {
    /// The kinds of [`PeerViolation`], with their codes on the wire.
    PeerViolationKind {
        FrameTooLong = 16, "frame-too-long";
        UnknownFrame = 19, "unknown-frame";
        Malformed = 20, "malformed";
        TrailingBytes = 21, "trailing-bytes";
        NotCanonical = 22, "not-canonical";
        BadName = 23, "bad-name";
        BadQos = 24, "bad-qos";
        ExpectedHello = 32, "expected-hello";
        UnexpectedHello = 33, "unexpected-hello";
        BadVersionRange = 34, "bad-version-range";
        BadLength = 69, "bad-length";
        UnknownCall = 86, "unknown-call";
        BadOffer = 99, "bad-offer";
        OfferLimit = 100, "offer-limit";
        UnknownOffer = 101, "unknown-offer";
        BadWant = 102, "bad-want";
        BadPath = 103, "bad-path";
        UnexpectedAnswer = 104, "unexpected-answer";
        NotWanted = 105, "not-wanted";
    }
}

codes! {
    /// Reasons to close a connection that are not violations.
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
    /// Reasons to reset a stream, or to stop reading it.
    StreamEnd {
        Superseded = 112, "superseded", "SM2-GWM-004";
        Expired = 113, "expired", "SM2-GWM-004";
        Withdrawn = 114, "withdrawn", "SM2-GWM-004";
        Cancelled = 115, "cancelled", "SM2-GWS-003";
    }
}

/// A violation of SPEC by a peer. A violation ends the connection.
pub type PeerViolation = Violation<PeerViolationKind>;

impl From<DecodeError> for PeerViolation {
    fn from(error: DecodeError) -> Self {
        match error {
            DecodeError::UnknownFrame => violation!(PeerViolationKind::UnknownFrame, "SM2-FRM-001"),
            DecodeError::Malformed => violation!(PeerViolationKind::Malformed, "SM2-FRM-001"),
            DecodeError::BadUtf8 => violation!(PeerViolationKind::BadName, "SM2-FRM-001"),
            DecodeError::BadName => violation!(PeerViolationKind::BadName, "SM2-NAM-001"),
            DecodeError::TrailingBytes => {
                violation!(PeerViolationKind::TrailingBytes, "SM2-FRM-001")
            }
            DecodeError::NotCanonical => violation!(PeerViolationKind::NotCanonical, "SM2-FRM-002"),
        }
    }
}
