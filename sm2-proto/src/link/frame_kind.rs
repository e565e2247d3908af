//! The kinds of link frames, with the roles that receive them and the lanes that use them.

use super::Role;

/// The kinds of link frames, with their numbers on the wire.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
#[repr(u8)]
pub enum FrameKind {
    /// The first frame of each end.
    Open = 1,
    /// Registers a segment with the receiver.
    Attach = 2,
    /// Unregisters a segment.
    Detach = 3,
    /// A publication.
    Data = 4,
    /// A call.
    Request = 5,
    /// The answer to a call.
    Reply = 6,
    /// Gives messages back.
    Release = 7,
    /// Caller: no longer wants a reply.
    Cancel = 8,
    /// The last frame of each end.
    Close = 9,
    /// Carries the descriptor of a ring.
    Ring = 16,
    /// Wakes the other end, which parked.
    Doorbell = 17,
    /// The receiver no longer uses a segment.
    Detached = 18,
    /// The publisher's program is alive.
    Alive = 19,
}

impl FrameKind {
    /// Every kind, ordered by number.
    pub const ALL: [Self; 13] = [
        Self::Open,
        Self::Attach,
        Self::Detach,
        Self::Data,
        Self::Request,
        Self::Reply,
        Self::Release,
        Self::Cancel,
        Self::Close,
        Self::Ring,
        Self::Doorbell,
        Self::Detached,
        Self::Alive,
    ];

    /// The kind with this number.
    #[must_use]
    pub fn from_number(number: u8) -> Option<Self> {
        Self::ALL.into_iter().find(|kind| *kind as u8 == number)
    }

    /// The column *received by* of the table in SPEC section 7.
    //= SM2-WIR-002
    #[must_use]
    pub const fn is_received_by(self, role: Role) -> bool {
        use Role::{Caller, Receiver, Sender, Server};
        match self {
            Self::Open | Self::Close | Self::Doorbell => true,
            Self::Attach | Self::Detach => matches!(role, Receiver | Caller | Server),
            Self::Data | Self::Alive => matches!(role, Receiver),
            Self::Request | Self::Cancel => matches!(role, Server),
            Self::Reply => matches!(role, Caller),
            Self::Release => matches!(role, Sender | Caller | Server),
            Self::Ring | Self::Detached => matches!(role, Sender | Caller | Server),
        }
    }

    /// Whether frames of this kind are legal on links of the ring lane (`ring`) or of the socket
    /// lane. For RING, `ring` says whether the sender of the frame offers the ring lane.
    //= SM2-RNG-001
    #[must_use]
    pub const fn is_on(self, ring: bool) -> bool {
        match self {
            Self::Data | Self::Request | Self::Reply | Self::Release => !ring,
            Self::Ring | Self::Doorbell | Self::Detached => ring,
            Self::Open | Self::Attach | Self::Detach | Self::Cancel | Self::Close | Self::Alive => {
                true
            }
        }
    }
}

/// The frames that carry a message.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Carrier {
    /// A publication.
    Data,
    /// A call.
    Request,
    /// The answer to a call.
    Reply,
}

impl Carrier {
    /// The carrier that an end with this role receives; for a sender, which receives none, the
    /// carrier that it sends.
    pub(super) const fn to(role: Role) -> Self {
        match role {
            Role::Sender | Role::Receiver => Self::Data,
            Role::Server => Self::Request,
            Role::Caller => Self::Reply,
        }
    }

    /// The kind of the frame that carries it.
    #[must_use]
    pub const fn kind(self) -> FrameKind {
        match self {
            Self::Data => FrameKind::Data,
            Self::Request => FrameKind::Request,
            Self::Reply => FrameKind::Reply,
        }
    }
}
