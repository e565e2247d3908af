//! The header before the payload of a message, a request or a reply: SPEC sections 14.4 and 14.5.

use super::{OfferId, PeerViolation, PeerViolationKind};
use crate::limits::MESSAGE_MAX;

/// The length of a [`Header`] in bytes.
pub const HEADER_LEN: usize = 40;

/// The first bytes of a stream or datagram that carries a payload.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct Header {
    /// The type of the header.
    pub kind: HeaderKind,
    /// The offer of the topic or service.
    pub offer: OfferId,
    /// The length of the payload in bytes.
    pub len: u64,
}

/// The type of a header, with the fields that only this type has.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum HeaderKind {
    /// A message of a topic.
    Message {
        /// The number of the message at its origin; grows with each message of the subject.
        sequence: u64,
        /// The time from publication until the stream was opened.
        age_ns: u64,
    },
    /// A request: the first half of a call.
    Request {
        /// The time left until the deadline of the call; 0 if it has none.
        left_ns: u64,
    },
    /// A reply: the second half of a call.
    Reply {
        /// How the call ended.
        status: Outcome,
    },
}

/// How a call ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
#[repr(u64)]
pub enum Outcome {
    /// The payload is the reply.
    Ok = 0,
    /// The server failed. The payload is the reason, in UTF-8.
    Failed = 1,
    /// The caller cancelled the call.
    Cancelled = 2,
    /// The deadline passed.
    DeadlinePassed = 3,
    /// There is no route to the server.
    Unreachable = 4,
    /// The rules do not allow the call.
    Denied = 5,
}

impl Outcome {
    /// All outcomes, in the order of their numbers on the wire.
    pub const ALL: [Self; 6] = [
        Self::Ok,
        Self::Failed,
        Self::Cancelled,
        Self::DeadlinePassed,
        Self::Unreachable,
        Self::Denied,
    ];

    /// Whether a reply with this outcome may have a payload.
    #[must_use]
    pub const fn has_payload(self) -> bool {
        matches!(self, Self::Ok | Self::Failed)
    }
}

impl Header {
    /// Encodes the header.
    #[must_use]
    pub fn to_bytes(&self) -> [u8; HEADER_LEN] {
        let (number, second, third) = match self.kind {
            HeaderKind::Message { sequence, age_ns } => (1, sequence, age_ns),
            HeaderKind::Request { left_ns } => (2, 0, left_ns),
            HeaderKind::Reply { status } => (3, status as u64, 0),
        };
        let mut bytes = [0; HEADER_LEN];
        let fields = [number, self.offer.0, second, third, self.len];
        for (place, field) in bytes.chunks_exact_mut(8).zip(fields) {
            place.copy_from_slice(&field.to_le_bytes());
        }
        bytes
    }

    /// Decodes a header.
    ///
    /// # Errors
    /// The bytes are not a legal header.
    //= SM2-GWM-002, SM2-PAY-008
    pub fn from_bytes(bytes: &[u8; HEADER_LEN]) -> Result<Self, PeerViolation> {
        let field = |at: usize| {
            let bytes = core::array::from_fn(|index| bytes[8 * at + index]);
            u64::from_le_bytes(bytes)
        };
        let [number, offer, second, third, len] = core::array::from_fn(field);
        let kind = match (number, second, third) {
            (1, sequence, age_ns) => HeaderKind::Message { sequence, age_ns },
            (2, 0, left_ns) => HeaderKind::Request { left_ns },
            (3, status, 0) => {
                let status = Outcome::ALL.into_iter().find(|it| *it as u64 == status);
                let status =
                    status.ok_or(violation!(PeerViolationKind::Malformed, "SM2-GWM-002"))?;
                if len > 0 && !status.has_payload() {
                    return Err(violation!(PeerViolationKind::BadLength, "SM2-GWM-002"));
                }
                HeaderKind::Reply { status }
            }
            _ => return Err(violation!(PeerViolationKind::Malformed, "SM2-GWM-002")),
        };
        if len > MESSAGE_MAX {
            return Err(violation!(PeerViolationKind::BadLength, "SM2-GWM-002"));
        }
        Ok(Self {
            kind,
            offer: OfferId(offer),
            len,
        })
    }
}
