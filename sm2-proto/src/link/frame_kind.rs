//! The kinds of frames on a link, and which end and which lane each belongs to.

use super::Role;

/// The kinds of link frames, by their numbers.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
#[repr(u8)]
pub enum FrameKind {
    /// The first frame of each side.
    Open = 1,
    /// Registers a segment.
    Attach = 2,
    /// Ends a segment.
    Detach = 3,
    /// A publication.
    Data = 4,
    /// A call.
    Request = 5,
    /// The answer to a call.
    Reply = 6,
    /// Gives messages back.
    Release = 7,
    /// The caller no longer wants a reply.
    Cancel = 8,
    /// The last frame of each side.
    Close = 9,
    /// The file of the ring.
    Ring = 16,
    /// Wakes who sleeps.
    Doorbell = 17,
    /// Whoever receives does not use a segment any more.
    Detached = 18,
}

impl FrameKind {
    /// Every kind, in the order of their numbers.
    pub const ALL: [Self; 12] = [
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
            Self::Data => matches!(role, Receiver),
            Self::Request | Self::Cancel => matches!(role, Server),
            Self::Reply => matches!(role, Caller),
            Self::Release => matches!(role, Sender | Caller | Server),
            Self::Ring | Self::Detached => matches!(role, Sender | Caller | Server),
        }
    }

    /// Whether links of the ring lane, or all others, have this kind of frames.
    //= SM2-RNG-001
    #[must_use]
    pub const fn is_on(self, ring: bool) -> bool {
        match self {
            Self::Data | Self::Request | Self::Reply | Self::Release => !ring,
            Self::Ring | Self::Doorbell | Self::Detached => ring,
            Self::Open | Self::Attach | Self::Detach | Self::Cancel | Self::Close => true,
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
    /// What an end with this role receives; of one that receives nothing: what it sends.
    pub(super) const fn to(role: Role) -> Self {
        match role {
            Role::Sender | Role::Receiver => Self::Data,
            Role::Server => Self::Request,
            Role::Caller => Self::Reply,
        }
    }

    /// The kind of its frame.
    #[must_use]
    pub const fn kind(self) -> FrameKind {
        match self {
            Self::Data => FrameKind::Data,
            Self::Request => FrameKind::Request,
            Self::Reply => FrameKind::Reply,
        }
    }
}
