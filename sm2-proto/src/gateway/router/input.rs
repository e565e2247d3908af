//! The inputs and outputs of a router.

use alloc::vec::Vec;

use super::super::{GatewayId, Hop, OfferId, Rules, Subject};

/// A fact that holds from now on. The router ignores inputs that name a peer without a connection,
/// an offer that does not exist, or the number of an existing offer as a new one: the peer and the
/// gateway may have changed their minds at the same time. [`Input::Taken`] may come while outputs
/// wait, as the answer to [`Output::DeclareProxy`].
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Input {
    /// These rules replace the previous ones. All sources are updated in pieces.
    Rules(Rules),
    /// A new connection with a peer is open. All sources are updated in pieces.
    Up {
        /// The id of the peer.
        peer: GatewayId,
    },
    /// The connection with a peer has ended.
    Down {
        /// The id of the peer.
        peer: GatewayId,
    },
    /// The own domain has, or no longer has, publishers or servers of a subject. A publisher or server
    /// that a gateway created for a remote one does not count.
    Local {
        /// The topic or service.
        subject: Subject,
        /// Whether there are any.
        present: bool,
    },
    /// A message or a call of this source is about to pass: the source is updated now, if sources are left to update.
    Use {
        /// The topic or service.
        subject: Subject,
        /// The source.
        source: Source,
    },
    /// Time has passed: the next piece of the sources is updated.
    Tick,
    /// Somebody in the own domain takes, or nobody takes any longer, what comes from an origin.
    Taken {
        /// The topic or service.
        subject: Subject,
        /// The gateway of the domain that it comes from.
        origin: GatewayId,
        /// The most messages that wait for a taker; `None` if there is no taker.
        taken: Option<u16>,
    },
    /// A peer offers a subject.
    Offered {
        /// The id of the peer.
        peer: GatewayId,
        /// The number of the offer.
        offer: OfferId,
        /// The topic or service.
        subject: Subject,
        /// The gateways from the origin to the peer.
        path: Vec<Hop>,
    },
    /// A peer has withdrawn an offer.
    Gone {
        /// The id of the peer.
        peer: GatewayId,
        /// The number of the offer.
        offer: OfferId,
    },
    /// A peer wants an offer of this gateway.
    Wanted {
        /// The id of the peer.
        peer: GatewayId,
        /// The number of the offer to the peer.
        offer: OfferId,
        /// The most messages that wait for the peer.
        depth: u16,
    },
    /// A peer no longer wants an offer of this gateway.
    Unwanted {
        /// The id of the peer.
        peer: GatewayId,
        /// The number of the offer to the peer.
        offer: OfferId,
    },
}

/// The domain that messages come from, and that requests go to.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Source {
    /// The own domain.
    Local,
    /// The domain of another gateway.
    Remote(GatewayId),
}

/// Work for the driver of a router.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub enum Output {
    /// Offer a subject to a peer.
    Offer {
        /// The id of the peer.
        peer: GatewayId,
        /// The number of the new offer.
        offer: OfferId,
        /// The topic or service.
        subject: Subject,
        /// The gateways from the origin to this one.
        path: Vec<Hop>,
    },
    /// Withdraw an offer.
    Unoffer {
        /// The peer that it was made to.
        peer: GatewayId,
        /// The number of the offer.
        offer: OfferId,
    },
    /// Want an offer of a peer.
    Want {
        /// The peer that made the offer.
        peer: GatewayId,
        /// The number of the offer.
        offer: OfferId,
        /// The most messages that wait for this gateway.
        depth: u16,
    },
    /// No longer want an offer of a peer.
    Unwant {
        /// The peer that made the offer.
        peer: GatewayId,
        /// The number of the offer.
        offer: OfferId,
    },
    /// Create a publisher or server in the own domain that stands for those of an origin.
    DeclareProxy {
        /// The topic or service.
        subject: Subject,
        /// The gateway of the domain that it comes from.
        origin: GatewayId,
        /// The peer through which it comes.
        peer: GatewayId,
    },
    /// Remove the publisher or server that stands for those of an origin.
    WithdrawProxy {
        /// The topic or service.
        subject: Subject,
        /// The gateway of the domain that it came from.
        origin: GatewayId,
    },
    /// Subscribe to the topic in the own domain, or become a client of the service there.
    Subscribe {
        /// The topic or service.
        subject: Subject,
        /// The most messages that wait for a peer.
        depth: u16,
    },
    /// End the subscription, or the client, in the own domain.
    Unsubscribe {
        /// The topic or service.
        subject: Subject,
    },
}
