//! Why a session or link ended: SPEC section 10, the one table of codes.

use core::fmt;

use serde::{Deserialize, Serialize};

/// A code as it travels in GOODBYE, UNLINK, UNLINKED and CLOSE.
///
/// Any number is legal; [`fmt::Display`] names those that this version knows.
//= SM2-COD-001
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
pub struct Code(pub u16);

macro_rules! codes {
    ($(#[$doc:meta])* $enum:ident { $($variant:ident = $code:literal, $name:literal, $clause:literal;)* }) => {
        $(#[$doc])*
        #[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
        #[repr(u16)]
        pub enum $enum {
            $(#[doc = concat!("`", $name, "` (", $clause, ")")] $variant = $code,)*
        }

        impl $enum {
            /// Every one, in the order of the codes.
            pub const ALL: &[Self] = &[$(Self::$variant),*];

            /// Its code on the wire.
            #[must_use]
            pub const fn code(self) -> Code {
                Code(self as u16)
            }

            /// Its name in SPEC section 10.
            #[must_use]
            pub const fn name(self) -> &'static str {
                match self { $(Self::$variant => $name,)* }
            }

            /// The clause that says so.
            #[must_use]
            pub const fn clause(self) -> &'static str {
                match self { $(Self::$variant => $clause,)* }
            }

            /// The one with this code.
            #[must_use]
            pub const fn from_code(code: Code) -> Option<Self> {
                match code.0 { $($code => Some(Self::$variant),)* _ => None }
            }
        }
    };
}

pub(crate) use codes;

codes! {
    /// An end that is nobody's breach of SPEC.
    Farewell {
        Done = 0, "done", "SM2-COD-001";
        GreetingTimeout = 1, "greeting-timeout", "SM2-SES-004";
        Stalled = 2, "stalled", "SM2-TRN-009";
        ShuttingDown = 3, "shutting-down", "SM2-COD-001";
        Resources = 4, "resources", "SM2-COD-001";
        PeerGone = 5, "peer-gone", "SM2-LNK-004";
        NotAdopted = 6, "not-adopted", "SM2-RES-005";
    }
}

codes! {
    /// A breach of SPEC by the other side: it ends the session or the link.
    Violation {
        FrameTooLong = 16, "frame-too-long", "SM2-TRN-004";
        FdCount = 17, "fd-count", "SM2-TRN-005";
        ControlTruncated = 18, "control-truncated", "SM2-TRN-005";
        UnknownFrame = 19, "unknown-frame", "SM2-FRM-001";
        Malformed = 20, "malformed", "SM2-FRM-001";
        TrailingBytes = 21, "trailing-bytes", "SM2-FRM-001";
        NotCanonical = 22, "not-canonical", "SM2-FRM-002";
        BadName = 23, "bad-name", "SM2-NAM-001";
        BadQos = 24, "bad-qos", "SM2-FRM-003";
        ExpectedHello = 32, "expected-hello", "SM2-SES-001";
        UnexpectedHello = 33, "unexpected-hello", "SM2-SES-001";
        BadVersionRange = 34, "bad-version-range", "SM2-SES-002";
        InterfaceNumber = 35, "interface-id", "SM2-IFC-001";
        UnknownInterface = 36, "unknown-interface", "SM2-IFC-003";
        UnknownLink = 37, "unknown-link", "SM2-LNK-003";
        UnexpectedClaim = 38, "unexpected-claim", "SM2-RES-003";
        BadClaim = 39, "bad-claim", "SM2-RES-003";
        WatchTwice = 40, "watch-twice", "SM2-WCH-001";
        CountersTwice = 41, "counters-twice", "SM2-CNT-001";
        BadSchema = 42, "bad-schema", "SM2-SCH-001";
        ExpectedWelcome = 48, "expected-welcome", "SM2-NOD-001";
        UnexpectedWelcome = 49, "unexpected-welcome", "SM2-NOD-001";
        BadVersion = 50, "bad-version", "SM2-NOD-002";
        LinkNumber = 51, "link-id", "SM2-LNK-005";
        BadLink = 52, "bad-link", "SM2-LNK-005";
        UnexpectedPage = 53, "unexpected-page", "SM2-IFC-007";
        UnexpectedChanges = 54, "unexpected-changes", "SM2-WCH-001";
        UnexpectedCounters = 55, "unexpected-counters", "SM2-CNT-002";
        UnexpectedSchema = 56, "unexpected-schema", "SM2-SCH-002";
        ExpectedOpen = 64, "expected-open", "SM2-OPN-001";
        UnexpectedOpen = 65, "unexpected-open", "SM2-OPN-001";
        BadOpen = 66, "bad-open", "SM2-OPN-002";
        BadWindow = 67, "bad-window", "SM2-OPN-003";
        WrongRole = 68, "wrong-role", "SM2-WIR-002";
        BadLength = 69, "bad-length", "SM2-WIR-001";
        ReservedNotZero = 70, "reserved-not-zero", "SM2-WIR-001";
        BadSequence = 71, "bad-sequence", "SM2-MSG-001";
        BadId = 72, "bad-id", "SM2-MSG-002";
        WindowExceeded = 73, "window-exceeded", "SM2-MSG-003";
        BadRelease = 74, "bad-release", "SM2-MSG-004";
        UnknownSegment = 75, "unknown-segment", "SM2-PAY-002";
        BadSlot = 76, "bad-slot", "SM2-PAY-002";
        SlotBusy = 77, "slot-busy", "SM2-PAY-005";
        NotSealed = 78, "not-sealed", "SM2-PAY-004";
        NotAMemfd = 79, "not-a-memfd", "SM2-SEG-001";
        SealsMissing = 80, "seals-missing", "SM2-SEG-001";
        BadSize = 81, "bad-size", "SM2-SEG-002";
        SegmentNumber = 82, "segment-id", "SM2-SEG-003";
        BadSegment = 83, "bad-segment", "SM2-SEG-003";
        SegmentLimit = 84, "segment-limit", "SM2-SEG-004";
        SegmentBusy = 85, "segment-busy", "SM2-SEG-005";
        UnknownCall = 86, "unknown-call", "SM2-SRV-003";
        BadCancel = 87, "bad-cancel", "SM2-SRV-004";
        CallLimit = 88, "call-limit", "SM2-SRV-002";
        WrongLane = 89, "wrong-lane", "SM2-RNG-001";
        BadRing = 90, "bad-ring", "SM2-RNG-002";
        BadWord = 91, "bad-word", "SM2-RNG-007";
    }
}

impl fmt::Display for Violation {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{} ({})", self.name(), self.clause())
    }
}

impl core::error::Error for Violation {}

impl fmt::Display for Farewell {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

impl fmt::Display for Code {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match (Farewell::from_code(*self), Violation::from_code(*self)) {
            (Some(farewell), _) => farewell.fmt(f),
            (_, Some(violation)) => violation.fmt(f),
            (None, None) => write!(f, "code {}", self.0),
        }
    }
}

impl From<Violation> for Code {
    fn from(violation: Violation) -> Self {
        violation.code()
    }
}

impl From<Farewell> for Code {
    fn from(farewell: Farewell) -> Self {
        farewell.code()
    }
}
