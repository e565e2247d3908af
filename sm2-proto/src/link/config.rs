//! The configuration of one end of a link.

use super::{MaxLen, Publications, RingLayout, Role};
use crate::{
    Contract, LinkId, Period,
    limits::{QOS_MAX, WINDOW_MAX},
};

/// The configuration of one end of a link: the terms of the LINK frame, and the QoS that this side
/// declared.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct Config {
    /// The link's id, from LINK.
    pub id: LinkId,
    /// The link's version, from LINK.
    pub version: u16,
    /// Which end this is.
    pub role: Role,
    /// From LINK: whether no message may be displaced. Always true on links of services.
    pub reliable: bool,
    /// From LINK: whether pooled messages are illegal.
    pub sealed: bool,
    /// Whether this end offers the ring lane. Ignored if the link is sealed. The driver of an end with a
    /// [`ring_layout`](Self::ring_layout) creates the file of that ring first, all zero, with the seals
    /// [`Seals::RING`](crate::Seals::RING), and maps it for writing. RING carries its descriptor. If the other end
    /// does not offer the ring lane, the ring is not used.
    pub ring: bool,
    /// How many messages are kept, 1 to 1,024. On a sender, this bounds the messages that the
    /// window does not admit yet. On all other roles, it bounds the messages that the application
    /// has not taken.
    pub depth: u16,
    /// How many messages the application may hold at a time, 1 to 1,024. A sender does not use it.
    pub max_borrowed: u16,
    /// The longest message that this end accepts. A sender does not use it.
    pub max_len: MaxLen,
    /// A receiver counts the periods of this length that pass without a message. No other role uses it.
    pub deadline: Period,
    /// The lifespan of the publisher at either end of the link. A caller or server does not use it.
    pub lifespan: Period,
    /// The lease that the subscriber at either end of the link demands. A caller or server does not use it.
    pub lease: Period,
    /// The publications that the OPEN of a sender states. No other role uses it.
    pub publications: Publications,
}

impl Config {
    /// The configuration of an interface's end of `link`, from the interface's contract. It offers
    /// no ring lane, and accepts messages of the [default](MaxLen::DEFAULT) length.
    #[must_use]
    pub const fn new(
        contract: &Contract,
        link: LinkId,
        version: u16,
        reliable: bool,
        sealed: bool,
    ) -> Self {
        let (depth, max_borrowed) = match contract {
            Contract::Publisher { offer, .. } => (offer.depth, 1),
            Contract::Subscriber { demand, .. } => (demand.depth, demand.max_borrowed),
            Contract::Server { qos, .. } | Contract::Client { qos, .. } => {
                (qos.depth, qos.max_borrowed)
            }
        };
        let role = Role::of(contract.kind());
        Self {
            id: link,
            version,
            role,
            reliable,
            sealed,
            ring: false,
            depth,
            max_borrowed,
            max_len: MaxLen::DEFAULT,
            deadline: contract.deadline(),
            lifespan: contract.lifespan(),
            lease: match role {
                Role::Receiver => contract.lease(),
                Role::Sender | Role::Caller | Role::Server => Period::NONE,
            },
            publications: Publications::UNKNOWN,
        }
    }

    /// The same configuration, with what the interface at the other end decides: the lifespan of a publisher, the
    /// lease of a subscriber.
    //= SM2-QOS-010, SM2-QOS-012
    #[must_use]
    pub const fn with_peer(mut self, peer: &Contract) -> Self {
        match self.role {
            Role::Receiver => self.lifespan = peer.lifespan(),
            Role::Sender => self.lease = peer.lease(),
            Role::Caller | Role::Server => {}
        }
        self
    }

    /// How many unreleased messages this end accepts (its `window`, SM2-OPN-003).
    #[must_use]
    pub const fn window(&self) -> u32 {
        match self.role {
            Role::Sender => 0,
            Role::Receiver | Role::Caller | Role::Server => {
                self.depth as u32 + self.max_borrowed as u32
            }
        }
    }

    /// `max_len` of this end's OPEN, in units of 1,024 bytes.
    //= SM2-OPN-005
    pub(super) const fn max_len_units(&self) -> u32 {
        if self.role.receives() {
            self.max_len.units()
        } else {
            0
        }
    }

    /// The layout of the ring that this end creates; `None` for a sender. The ring is as deep as
    /// the number of messages that may wait for the application. That number is `depth`, except for
    /// a caller, whose ring has room for the reply to each of its calls.
    //= SM2-RNG-002
    #[must_use]
    pub const fn ring_layout(&self) -> Option<RingLayout> {
        let window = self.window();
        let depth = match self.role {
            Role::Sender => return None,
            Role::Receiver | Role::Server => self.depth,
            Role::Caller if window > QOS_MAX as u32 => QOS_MAX,
            Role::Caller => window as u16 - 1,
        };
        RingLayout::new(depth, window)
    }

    /// Returns the configuration with every value in its range, so that the machine can rely on the
    /// ranges.
    pub(super) fn in_range(self) -> Self {
        Self {
            reliable: self.reliable || matches!(self.role, Role::Caller | Role::Server),
            //= SM2-RNG-001
            ring: self.ring && !self.sealed,
            depth: self.depth.clamp(1, QOS_MAX),
            max_borrowed: self.max_borrowed.clamp(1, QOS_MAX),
            //= SM2-QOS-009
            deadline: match self.role {
                Role::Receiver => self.deadline,
                Role::Sender | Role::Caller | Role::Server => Period::NONE,
            },
            lifespan: of_topic(self.role, self.lifespan),
            lease: of_topic(self.role, self.lease),
            publications: match self.role {
                Role::Sender if self.publications.is_legal(true) => self.publications,
                _ => Publications::UNKNOWN,
            },
            ..self
        }
    }
}

/// The links of services have no such time.
const fn of_topic(role: Role, period: Period) -> Period {
    match role {
        Role::Sender | Role::Receiver => period,
        Role::Caller | Role::Server => Period::NONE,
    }
}

const _: () = assert!(2 * QOS_MAX as u32 <= WINDOW_MAX);
