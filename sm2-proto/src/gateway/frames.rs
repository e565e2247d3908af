//! Frames of the control stream: SPEC section 14.2. The order of variants and fields is the wire
//! format.

use alloc::vec::Vec;

use serde::{Deserialize, Serialize};

use super::{AskId, GatewayId, OfferId, PeerViolation, PeerViolationKind, SubjectKind};
use crate::{
    Name, TypeId, control,
    limits::{GATEWAY_FRAME_MAX, HOPS_MAX, QOS_MAX},
};

/// What one gateway says to another.
#[derive(Clone, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub enum Frame {
    /// Who this is.
    Hello {
        /// The oldest version that it speaks.
        min_version: u16,
        /// The newest version that it speaks.
        max_version: u16,
        /// Greater than in any process before with the same key.
        epoch: u64,
        /// What people call it.
        name: Name,
    },
    /// The peer may have this.
    Offer {
        /// The number of the offer; grows.
        offer: OfferId,
        /// What it is.
        subject: Subject,
        /// From its origin to the sender.
        path: Vec<Hop>,
    },
    /// The peer may not have it any more.
    Unoffer {
        /// Which.
        offer: OfferId,
    },
    /// The peer's offer is forgotten here.
    Unoffered {
        /// Which.
        offer: OfferId,
    },
    /// This gateway wants what is offered.
    Want {
        /// Which.
        offer: OfferId,
        /// How many messages wait for it at most.
        depth: u16,
    },
    /// It does not want it any more.
    Unwant {
        /// Which.
        offer: OfferId,
    },
    /// No more of it will be sent.
    Unwanted {
        /// Which.
        offer: OfferId,
    },
    /// Could this gateway have that?
    Ask {
        /// The number of the question.
        ask: AskId,
        /// A topic or a service.
        kind: SubjectKind,
        /// Its name.
        name: Name,
    },
    /// The answer.
    Answer {
        /// To which question.
        ask: AskId,
        /// What it is.
        verdict: Verdict,
    },
}

/// What is offered.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
pub enum Subject {
    /// Messages.
    Topic {
        /// Its name.
        name: Name,
        /// Of what they are.
        data: TypeId,
        /// Whether its publishers are reliable.
        reliable: bool,
        /// How many messages they keep for subscribers that come later, together.
        latched: u16,
    },
    /// Calls.
    Service {
        /// Its name.
        name: Name,
        /// Of what requests are.
        request: TypeId,
        /// Of what replies are.
        reply: TypeId,
    },
}

impl Subject {
    /// A topic or a service.
    #[must_use]
    pub const fn kind(&self) -> SubjectKind {
        match self {
            Self::Topic { .. } => SubjectKind::Topic,
            Self::Service { .. } => SubjectKind::Service,
        }
    }

    /// Its name.
    #[must_use]
    pub const fn name(&self) -> &Name {
        match self {
            Self::Topic { name, .. } | Self::Service { name, .. } => name,
        }
    }

    /// How many messages are kept for subscribers that come later.
    #[must_use]
    pub const fn latched(&self) -> u16 {
        match self {
            Self::Topic { latched, .. } => *latched,
            Self::Service { .. } => 0,
        }
    }
}

/// One gateway that an offer came through.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
pub struct Hop {
    /// Which.
    pub gateway: GatewayId,
    /// Of its process.
    pub epoch: u64,
}

/// Whether a peer could have something.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub enum Verdict {
    /// It has an offer of it.
    Offered,
    /// The rules do not let it.
    Denied,
    /// Nobody here has it.
    Absent,
}

impl Frame {
    const COUNT: u32 = 9;

    /// As it stands in the control stream, with its length.
    //= SM2-GWF-002
    #[must_use]
    pub fn to_bytes(&self) -> Vec<u8> {
        let body = control::encode(self);
        let len = u32::try_from(body.len()).unwrap_or(u32::MAX);
        [&len.to_le_bytes()[..], &body].concat()
    }

    /// Reads a body, without its length.
    ///
    /// # Errors
    /// It is not exactly one legal frame.
    //= SM2-GWF-002
    pub fn from_body(body: &[u8]) -> Result<Self, PeerViolation> {
        if body.len() > GATEWAY_FRAME_MAX {
            return Err(violation!(PeerViolationKind::FrameTooLong, "SM2-GWF-002"));
        }
        let frame: Self = control::decode(body, Self::COUNT)?;
        frame.check()?;
        Ok(frame)
    }

    //= SM2-GWO-006
    pub(super) fn check(&self) -> Result<(), PeerViolation> {
        match self {
            Self::Want { depth, .. } if !(1..=QOS_MAX).contains(depth) => {
                Err(violation!(PeerViolationKind::BadQos, "SM2-GWO-006"))
            }
            Self::Offer { subject, .. } if subject.latched() > QOS_MAX => {
                Err(violation!(PeerViolationKind::BadQos, "SM2-GWO-006"))
            }
            Self::Offer { path, .. } if !is_path(path) => {
                Err(violation!(PeerViolationKind::BadPath, "SM2-GWO-006"))
            }
            _ => Ok(()),
        }
    }
}

/// Whether a message can have come along here.
fn is_path(path: &[Hop]) -> bool {
    let is_new = |(at, hop): (usize, &Hop)| {
        let before = &path[..at];
        before.iter().all(|it| it.gateway != hop.gateway)
    };
    (1..=HOPS_MAX).contains(&path.len()) && path.iter().enumerate().all(is_new)
}

/// The bytes of a control stream as frames. What it keeps is less than one of the longest.
#[derive(Clone, Debug, Default, PartialEq, Eq, Hash)]
pub struct FrameReader {
    bytes: Vec<u8>,
    /// How many of them were read.
    read: usize,
}

impl FrameReader {
    /// What came next, in pieces of any length. Take all frames before there is more.
    pub fn push(&mut self, bytes: &[u8]) {
        self.bytes.extend_from_slice(bytes);
    }

    /// The next frame, if all of it is there.
    ///
    /// # Errors
    /// The peer broke SPEC: no frame can be read after this one.
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

    /// Moves what is left to the beginning, once for all frames before it.
    fn compact(&mut self) {
        self.bytes.drain(..self.read);
        self.read = 0;
    }

    /// Whether the stream could end here.
    #[must_use]
    pub fn is_between_frames(&self) -> bool {
        self.read == self.bytes.len()
    }
}
