//! The maximum length of a message that one end of a link accepts.
//!
//! The maximum is in OPEN and not in DECLARE: only the two ends of a link need it, and a sender knows it before the
//! first message, so a sender never guesses. It drops a longer message on that link at once, with a reason of its own,
//! since waiting would not help. The check costs the sender one comparison, and a receiver nothing: its maximum takes
//! the place of the protocol's.

use crate::limits::{INLINE_MAX, MESSAGE_MAX};

/// The maximum length of a message that one end of a link accepts: 1,024 bytes to 2^40 bytes, in
/// steps of 1,024 bytes.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct MaxLen {
    units: u32,
}

impl MaxLen {
    /// The unit of `max_len` in OPEN, in bytes.
    pub const UNIT_BYTES: u64 = 1_024;
    /// The least maximum: every end accepts messages of this length.
    pub const LEAST: Self = Self { units: 1 };
    /// The greatest maximum, which accepts every legal message.
    pub const GREATEST: Self = Self::from_bytes(MESSAGE_MAX);
    /// The maximum of an end whose program chose none: 1 GiB. It is above the longest messages of
    /// robots (camera images, point clouds and maps of 10 to 500 MB). A sender can still make its
    /// receiver map that much at most, and not the 1 TiB that the protocol allows.
    pub const DEFAULT: Self = Self::from_bytes(1 << 30);

    /// The least maximum that accepts messages of this length. A length of more than 2^40 bytes
    /// counts as 2^40 bytes.
    #[must_use]
    pub const fn from_bytes(bytes: u64) -> Self {
        let bytes = if bytes > MESSAGE_MAX {
            MESSAGE_MAX
        } else {
            bytes
        };
        let units = bytes.div_ceil(Self::UNIT_BYTES) as u32;
        Self {
            units: if units == 0 { 1 } else { units },
        }
    }

    /// Reads `max_len` of an OPEN that is not a sender's. `None` if it is out of its range.
    //= SM2-OPN-005
    pub(super) const fn from_units(units: u32) -> Option<Self> {
        match units {
            1..=UNITS_MAX => Some(Self { units }),
            _ => None,
        }
    }

    /// `max_len` in OPEN.
    pub(super) const fn units(self) -> u32 {
        self.units
    }

    /// The length of the longest message that is accepted, in bytes.
    #[must_use]
    #[inline]
    pub const fn bytes(self) -> u64 {
        self.units as u64 * Self::UNIT_BYTES
    }
}

impl Default for MaxLen {
    fn default() -> Self {
        Self::DEFAULT
    }
}

const UNITS_MAX: u32 = (MESSAGE_MAX / MaxLen::UNIT_BYTES) as u32;

const _: () = assert!(UNITS_MAX as u64 * MaxLen::UNIT_BYTES == MESSAGE_MAX);
const _: () = assert!(MaxLen::GREATEST.bytes() == MESSAGE_MAX);
const _: () = assert!(MaxLen::DEFAULT.bytes() > INLINE_MAX as u64);
