//! Frames of the control stream: SPEC section 14.2. The order of variants and fields defines the
//! encoding.

use alloc::vec::Vec;

use serde::{Deserialize, Serialize};

use super::{AskId, GatewayId, OfferId, PeerViolation, PeerViolationKind, SubjectKind};
use crate::{
    Name, TypeId, control,
    limits::{GATEWAY_FRAME_MAX, HOPS_MAX, QOS_MAX},
};

/// A frame of the control stream. Both sides send all of them.
#[derive(Clone, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub enum Frame {
    /// The first frame of each side.
    Hello {
        /// The oldest version that the sender speaks.
        min_version: u16,
        /// The newest version that the sender speaks.
        max_version: u16,
        /// The epoch of the sending process: greater than that of any earlier process with its key.
        epoch: u64,
        /// The name of the sender, for people.
        name: Name,
    },
    /// Offers a topic or service to the receiver.
    Offer {
        /// The number of the new offer.
        offer: OfferId,
        /// The topic or service.
        subject: Subject,
        /// The gateways from the origin to the sender.
        path: Vec<Hop>,
    },
    /// Withdraws an offer of the sender.
    Unoffer {
        /// The number of the offer.
        offer: OfferId,
    },
    /// Confirms UNOFFER: the sender has forgotten the offer.
    Unoffered {
        /// The number of the offer.
        offer: OfferId,
    },
    /// Subscribes to an offer of the receiver.
    Want {
        /// The number of the offer.
        offer: OfferId,
        /// The most messages that wait for the sender, 1 to 1,024.
        depth: u16,
    },
    /// Unsubscribes from an offer of the receiver.
    Unwant {
        /// The number of the offer.
        offer: OfferId,
    },
    /// Confirms UNWANT: no more messages of the offer will be sent.
    Unwanted {
        /// The number of the offer.
        offer: OfferId,
    },
    /// Asks whether the sender could have a topic or service.
    Ask {
        /// The number of the question.
        ask: AskId,
        /// Whether the name is of a topic or a service.
        kind: SubjectKind,
        /// The name.
        name: Name,
    },
    /// Answers the oldest question without an answer.
    Answer {
        /// The number of the question.
        ask: AskId,
        /// The answer.
        verdict: Verdict,
    },
}

/// A topic or a service that gateways offer.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
pub enum Subject {
    /// A topic.
    Topic {
        /// The name.
        name: Name,
        /// The type of its messages.
        data: TypeId,
        /// Whether its publishers are reliable.
        reliable: bool,
        /// How many messages its publishers keep for later subscribers, in total.
        latched: u16,
    },
    /// A service.
    Service {
        /// The name.
        name: Name,
        /// The type of requests.
        request: TypeId,
        /// The type of replies.
        reply: TypeId,
    },
}

impl Subject {
    /// Whether the subject is a topic or a service.
    #[must_use]
    pub const fn kind(&self) -> SubjectKind {
        match self {
            Self::Topic { .. } => SubjectKind::Topic,
            Self::Service { .. } => SubjectKind::Service,
        }
    }

    /// The name of the subject.
    #[must_use]
    pub const fn name(&self) -> &Name {
        match self {
            Self::Topic { name, .. } | Self::Service { name, .. } => name,
        }
    }

    /// How many messages are kept for later subscribers; 0 for a service.
    #[must_use]
    pub const fn latched(&self) -> u16 {
        match self {
            Self::Topic { latched, .. } => *latched,
            Self::Service { .. } => 0,
        }
    }
}

/// A gateway on the path of an offer.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
pub struct Hop {
    /// The id of the gateway.
    pub gateway: GatewayId,
    /// The epoch of its process.
    pub epoch: u64,
}

/// The answer to ASK (SM2-GWO-005).
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub enum Verdict {
    /// The asking side has an offer of the subject.
    Offered,
    /// The rules do not allow the asking side to have the subject.
    Denied,
    /// The rules would allow it, but there is no such offer.
    Absent,
}

impl Frame {
    const COUNT: u32 = 9;

    /// Encodes the frame for the control stream: length and body.
    //= SM2-GWF-002
    #[must_use]
    pub fn to_bytes(&self) -> Vec<u8> {
        let body = control::encode(self);
        let len = u32::try_from(body.len()).unwrap_or(u32::MAX);
        [&len.to_le_bytes()[..], &body].concat()
    }

    /// Decodes the body of a frame, without the length before it.
    ///
    /// # Errors
    /// The body is not exactly one legal frame.
    //= SM2-GWF-002
    pub fn from_body(body: &[u8]) -> Result<Self, PeerViolation> {
        if body.len() > GATEWAY_FRAME_MAX {
            return Err(violation!(PeerViolationKind::FrameTooLong, "SM2-GWF-002"));
        }
        let frame: Self = control::decode(body, Self::COUNT)?;
        frame.check()?;
        Ok(frame)
    }

    /// Checks the bounds of the fields.
    //= SM2-GWO-007
    pub(super) fn check(&self) -> Result<(), PeerViolation> {
        match self {
            Self::Want { depth, .. } if !(1..=QOS_MAX).contains(depth) => {
                Err(violation!(PeerViolationKind::BadQos, "SM2-GWO-007"))
            }
            Self::Offer { subject, .. } if subject.latched() > QOS_MAX => {
                Err(violation!(PeerViolationKind::BadQos, "SM2-GWO-007"))
            }
            Self::Offer { path, .. } if !is_path(path) => {
                Err(violation!(PeerViolationKind::BadPath, "SM2-GWO-007"))
            }
            _ => Ok(()),
        }
    }
}

/// Whether a path has a legal length and names no gateway twice.
fn is_path(path: &[Hop]) -> bool {
    let is_new = |(at, hop): (usize, &Hop)| {
        let before = &path[..at];
        before.iter().all(|it| it.gateway != hop.gateway)
    };
    (1..=HOPS_MAX).contains(&path.len()) && path.iter().enumerate().all(is_new)
}

/// Splits the bytes of a control stream into frames. It buffers less than one frame of the greatest
/// length, if the caller takes all frames after each push.
#[derive(Clone, Debug, Default, PartialEq, Eq, Hash)]
pub struct FrameReader {
    bytes: Vec<u8>,
    /// The length of the frames at the start of `bytes` that were returned already.
    read: usize,
}

impl FrameReader {
    /// Appends bytes that were received, in pieces of any length. Take all frames with
    /// [`next_frame`](Self::next_frame) before the next call.
    pub fn push(&mut self, bytes: &[u8]) {
        self.bytes.extend_from_slice(bytes);
    }

    /// The next frame; `None` if its last byte has not been received.
    ///
    /// # Errors
    /// The peer broke SPEC. Every later call returns the same violation.
    //= SM2-GWF-002
    pub fn next_frame(&mut self) -> Result<Option<Frame>, PeerViolation> {
        let Some((len, rest)) = self.bytes[self.read..].split_first_chunk() else {
            self.compact();
            return Ok(None);
        };
        let len = u32::from_le_bytes(*len) as usize;
        if len > GATEWAY_FRAME_MAX {
            return Err(violation!(PeerViolationKind::FrameTooLong, "SM2-GWF-002"));
        }
        if len == 0 {
            return Err(violation!(PeerViolationKind::Malformed, "SM2-GWF-002"));
        }
        let Some(body) = rest.get(..len) else {
            self.compact();
            return Ok(None);
        };
        let frame = Frame::from_body(body)?;
        self.read += size_of::<u32>() + len;
        Ok(Some(frame))
    }

    /// Removes the frames that were returned, once for all of them.
    fn compact(&mut self) {
        self.bytes.drain(..self.read);
        self.read = 0;
    }

    /// Whether the stream may end here: no part of a frame is buffered.
    #[must_use]
    pub fn is_between_frames(&self) -> bool {
        self.read == self.bytes.len()
    }
}
