//! The codes that end sessions and links: SPEC section 10.

use core::fmt;

use serde::{Deserialize, Serialize};

/// A code as GOODBYE, UNLINK, UNLINKED and CLOSE carry it.
///
/// Any number is legal; [`fmt::Display`] names those that this version knows.
//= SM2-COD-001
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
pub struct Code(pub u16);

/// Defines a table of codes: a closed enum with the numbers and names of its rows. A table whose
/// rows name a clause also has the method `clause`.
macro_rules! codes {
    ($(#[$doc:meta])* $enum:ident { $($variant:ident = $code:literal, $name:literal, $clause:literal;)* }) => {
        $crate::code::codes! { $(#[$doc])* $enum { $($variant = $code, $name;)* } }

        impl $enum {
            /// The clause that defines the code.
            #[must_use]
            pub const fn clause(self) -> $crate::Clause {
                match self { $(Self::$variant => $crate::clause!($clause),)* }
            }
        }
    };
    ($(#[$doc:meta])* $enum:ident { $($variant:ident = $code:literal, $name:literal;)* }) => {
        $(#[$doc])*
        #[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
        #[repr(u16)]
        pub enum $enum {
            $(#[doc = concat!("`", $name, "`")] $variant = $code,)*
        }

        impl $enum {
            /// All rows, in the order of the codes.
            pub const ALL: &[Self] = &[$(Self::$variant),*];

            /// The code as frames carry it.
            #[must_use]
            pub const fn code(self) -> $crate::Code {
                $crate::Code(self as u16)
            }

            /// The name in SPEC's table of codes.
            #[must_use]
            pub const fn name(self) -> &'static str {
                match self { $(Self::$variant => $name,)* }
            }

            /// The row with this code.
            #[must_use]
            pub const fn from_code(code: $crate::Code) -> Option<Self> {
                match code.0 { $($code => Some(Self::$variant),)* _ => None }
            }
        }

        impl core::fmt::Display for $enum {
            fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
                f.write_str(self.name())
            }
        }

        impl From<$enum> for $crate::Code {
            fn from(one: $enum) -> Self {
                one.code()
            }
        }
    };
}

pub(crate) use codes;

codes! {
    /// An end of a session or link that is not a breach of SPEC.
    Farewell {
        Done = 0, "done", "SM2-COD-001";
        GreetingTimeout = 1, "greeting-timeout", "SM2-SES-004";
        Stalled = 2, "stalled", "SM2-TRN-008";
        ShuttingDown = 3, "shutting-down", "SM2-SES-008";
        Resources = 4, "resources", "SM2-COD-001";
        PeerGone = 5, "peer-gone", "SM2-LNK-005";
        NotAdopted = 6, "not-adopted", "SM2-RES-005";
        Denied = 7, "denied", "SM2-ACC-014";
    }
}

codes! {
    /// The kinds of [`Violation`](crate::Violation), by the codes that frames carry.
    ViolationKind {
        FrameTooLong = 16, "frame-too-long";
        FdCount = 17, "fd-count";
        UnknownFrame = 19, "unknown-frame";
        Malformed = 20, "malformed";
        TrailingBytes = 21, "trailing-bytes";
        NotCanonical = 22, "not-canonical";
        BadName = 23, "bad-name";
        BadQos = 24, "bad-qos";
        ExpectedHello = 32, "expected-hello";
        UnexpectedHello = 33, "unexpected-hello";
        BadVersionRange = 34, "bad-version-range";
        BadInterfaceId = 35, "interface-id";
        UnknownInterface = 36, "unknown-interface";
        UnknownLink = 37, "unknown-link";
        UnexpectedClaim = 38, "unexpected-claim";
        BadClaim = 39, "bad-claim";
        WatchTwice = 40, "watch-twice";
        CountersTwice = 41, "counters-twice";
        BadSchema = 42, "bad-schema";
        ReloadTwice = 43, "reload-twice";
        UnexpectedSuspended = 44, "unexpected-suspended";
        ExpectedWelcome = 48, "expected-welcome";
        UnexpectedWelcome = 49, "unexpected-welcome";
        BadVersion = 50, "bad-version";
        BadLinkId = 51, "link-id";
        BadLink = 52, "bad-link";
        UnexpectedPage = 53, "unexpected-page";
        UnexpectedChanges = 54, "unexpected-changes";
        UnexpectedCounters = 55, "unexpected-counters";
        UnexpectedSchema = 56, "unexpected-schema";
        UnexpectedReloaded = 57, "unexpected-reloaded";
        ExpectedOpen = 64, "expected-open";
        UnexpectedOpen = 65, "unexpected-open";
        BadOpen = 66, "bad-open";
        BadWindow = 67, "bad-window";
        WrongRole = 68, "wrong-role";
        BadLength = 69, "bad-length";
        ReservedNotZero = 70, "reserved-not-zero";
        BadSequence = 71, "bad-sequence";
        BadId = 72, "bad-id";
        WindowExceeded = 73, "window-exceeded";
        BadRelease = 74, "bad-release";
        UnknownSegment = 75, "unknown-segment";
        BadSlot = 76, "bad-slot";
        SlotBusy = 77, "slot-busy";
        NotSealed = 78, "not-sealed";
        NotAMemfd = 79, "not-a-memfd";
        SealsMissing = 80, "seals-missing";
        BadSize = 81, "bad-size";
        BadSegmentId = 82, "segment-id";
        BadSegment = 83, "bad-segment";
        SegmentLimit = 84, "segment-limit";
        SegmentBusy = 85, "segment-busy";
        UnknownCall = 86, "unknown-call";
        BadCancel = 87, "bad-cancel";
        CallLimit = 88, "call-limit";
        WrongLane = 89, "wrong-lane";
        BadRing = 90, "bad-ring";
        BadWord = 91, "bad-word";
        MessageTooLong = 92, "message-too-long";
    }
}

impl fmt::Display for Code {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match (Farewell::from_code(*self), ViolationKind::from_code(*self)) {
            (Some(farewell), _) => farewell.fmt(f),
            (_, Some(violation)) => violation.fmt(f),
            (None, None) => write!(f, "code {}", self.0),
        }
    }
}
