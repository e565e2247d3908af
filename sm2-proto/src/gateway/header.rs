//! What stands before the payload of a message, a request and a reply: SPEC sections 14.4, 14.5.

use super::{OfferId, PeerViolation, PeerViolationKind};
use crate::limits::MESSAGE_MAX;

/// The bytes of a [`Header`].
pub const HEADER_LEN: usize = 40;

/// The first bytes of a stream that carries a payload.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct Header {
    /// What it carries.
    pub carried: Carried,
    /// The number of the offer.
    pub offer: OfferId,
    /// How many bytes of payload follow.
    pub len: u64,
}

/// What a stream carries.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Carried {
    /// A message of a topic.
    Message {
        /// Its number at the origin; grows with each message of the subject.
        sequence: u64,
        /// Since publication, when the stream was opened.
        age_ns: u64,
    },
    /// A call.
    Request {
        /// What is left until its deadline; 0 if it has none.
        left_ns: u64,
    },
    /// What became of a call.
    Reply {
        /// How it ended.
        status: Outcome,
    },
}

/// How a call ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
#[repr(u64)]
pub enum Outcome {
    /// The payload is the reply.
    Ok = 0,
    /// The payload says why not.
    Failed = 1,
    /// The caller did not want it any more.
    Cancelled = 2,
    /// Its deadline passed.
    DeadlinePassed = 3,
    /// The way to the server is gone.
    Unreachable = 4,
    /// The rules do not allow it.
    Denied = 5,
}

impl Outcome {
    /// Every one, in the order of their numbers.
    pub const ALL: [Self; 6] = [
        Self::Ok,
        Self::Failed,
        Self::Cancelled,
        Self::DeadlinePassed,
        Self::Unreachable,
        Self::Denied,
    ];

    /// Whether a reply with it may have a payload.
    #[must_use]
    pub const fn has_payload(self) -> bool {
        matches!(self, Self::Ok | Self::Failed)
    }
}

impl Header {
    /// As it is sent.
    #[must_use]
    pub fn to_bytes(&self) -> [u8; HEADER_LEN] {
        let (kind, second, third) = match self.carried {
            Carried::Message { sequence, age_ns } => (1, sequence, age_ns),
            Carried::Request { left_ns } => (2, 0, left_ns),
            Carried::Reply { status } => (3, status as u64, 0),
        };
        let mut bytes = [0; HEADER_LEN];
        let fields = [kind, self.offer.0, second, third, self.len];
        for (place, field) in bytes.chunks_exact_mut(8).zip(fields) {
            place.copy_from_slice(&field.to_le_bytes());
        }
        bytes
    }

    /// Reads what stands at the beginning of a stream.
    ///
    /// # Errors
    /// No such header is legal.
    //= SM2-GWM-002, SM2-PAY-008
    pub fn from_bytes(bytes: &[u8; HEADER_LEN]) -> Result<Self, PeerViolation> {
        let field = |at: usize| {
            let bytes = core::array::from_fn(|index| bytes[8 * at + index]);
            u64::from_le_bytes(bytes)
        };
        let [kind, offer, second, third, len] = core::array::from_fn(field);
        let carried = match (kind, second, third) {
            (1, sequence, age_ns) => Carried::Message { sequence, age_ns },
            (2, 0, left_ns) => Carried::Request { left_ns },
            (3, number, 0) => {
                let status = Outcome::ALL.into_iter().find(|it| *it as u64 == number);
                let status =
                    status.ok_or(violation!(PeerViolationKind::Malformed, "SM2-GWM-002"))?;
                if len > 0 && !status.has_payload() {
                    return Err(violation!(PeerViolationKind::BadLength, "SM2-GWM-002"));
                }
                Carried::Reply { status }
            }
            _ => return Err(violation!(PeerViolationKind::Malformed, "SM2-GWM-002")),
        };
        if len > MESSAGE_MAX {
            return Err(violation!(PeerViolationKind::BadLength, "SM2-GWM-002"));
        }
        Ok(Self {
            carried,
            offer: OfferId(offer),
            len,
        })
    }
}
