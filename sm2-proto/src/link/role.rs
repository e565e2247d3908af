//! The roles of the ends of links.
//!
//! Sender, receiver, caller and server share phases, flow control, payload forms and accounting. One machine therefore
//! has all four roles, and a table states which frames a role may receive (SM2-WIR-002): four machines would contain
//! the same code four times.

use crate::Kind;

/// The role of one end of a link. Each role has one counterpart.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
#[repr(u8)]
pub enum Role {
    /// A publisher's end: sends DATA.
    Sender = 0,
    /// A subscriber's end: receives DATA.
    Receiver = 1,
    /// A client's end: sends REQUEST, receives REPLY.
    Caller = 2,
    /// A server's end: receives REQUEST, sends REPLY.
    Server = 3,
}

impl Role {
    /// Every role, ordered by number.
    pub const ALL: [Self; 4] = [Self::Sender, Self::Receiver, Self::Caller, Self::Server];

    /// The role that an interface of this kind has on its links.
    #[must_use]
    pub const fn of(kind: Kind) -> Self {
        match kind {
            Kind::Publisher => Self::Sender,
            Kind::Subscriber => Self::Receiver,
            Kind::Client => Self::Caller,
            Kind::Server => Self::Server,
        }
    }

    /// The role of the other end.
    #[must_use]
    pub const fn counterpart(self) -> Self {
        match self {
            Self::Sender => Self::Receiver,
            Self::Receiver => Self::Sender,
            Self::Caller => Self::Server,
            Self::Server => Self::Caller,
        }
    }

    /// Whether this end sends messages.
    #[must_use]
    pub const fn sends(self) -> bool {
        !matches!(self, Self::Receiver)
    }

    /// Whether this end receives messages.
    #[must_use]
    pub const fn receives(self) -> bool {
        !matches!(self, Self::Sender)
    }
}
