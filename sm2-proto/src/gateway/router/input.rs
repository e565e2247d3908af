//! What goes into a router and comes out of it.

use alloc::vec::Vec;

use super::super::{GatewayId, Hop, OfferId, Rules, Subject};

/// A fact that holds from now on. The router ignores inputs that name a peer without a connection,
/// an offer that does not exist, or the number of an existing offer as a new one: the peer and the
/// gateway may have changed their minds at the same time. [`Input::Taken`] may come while outputs
/// wait, as the answer to [`Output::Show`].
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Input {
    /// There are other rules.
    Rules(Rules),
    /// There is a connection with this peer, on which nothing was said yet.
    Up {
        /// With whom.
        peer: GatewayId,
    },
    /// There is none any more.
    Down {
        /// With whom.
        peer: GatewayId,
    },
    /// Whether the domain has publishers or servers of this, besides those that stand for remote
    /// ones.
    Local {
        /// Of what.
        subject: Subject,
        /// Whether there is one.
        present: bool,
    },
    /// Whether somebody in the domain takes what comes from there.
    Taken {
        /// What.
        subject: Subject,
        /// From which gateway's domain.
        origin: GatewayId,
        /// How many messages wait for them at most, if there is anybody.
        taken: Option<u16>,
    },
    /// A peer offers this.
    Offered {
        /// Who.
        peer: GatewayId,
        /// Its number there.
        offer: OfferId,
        /// What it is.
        subject: Subject,
        /// From the origin to the peer.
        path: Vec<Hop>,
    },
    /// It does not any more.
    Gone {
        /// Who.
        peer: GatewayId,
        /// Its number there.
        offer: OfferId,
    },
    /// A peer wants what it was offered.
    Wanted {
        /// Who.
        peer: GatewayId,
        /// The number of the offer to it.
        offer: OfferId,
        /// How many messages wait for it at most.
        depth: u16,
    },
    /// It does not any more.
    Unwanted {
        /// Who.
        peer: GatewayId,
        /// The number of the offer to it.
        offer: OfferId,
    },
}

/// Where messages come from, and requests go to.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Source {
    /// This gateway's domain.
    Local,
    /// That of another.
    Remote(GatewayId),
}

/// What is to be done.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub enum Output {
    /// Offer this to a peer.
    Offer {
        /// To whom.
        peer: GatewayId,
        /// The number of the offer.
        offer: OfferId,
        /// What it is.
        subject: Subject,
        /// From the origin to this gateway.
        path: Vec<Hop>,
    },
    /// Withdraw an offer.
    Unoffer {
        /// From whom.
        peer: GatewayId,
        /// Its number.
        offer: OfferId,
    },
    /// Want what a peer offers.
    Want {
        /// From whom.
        peer: GatewayId,
        /// The number of its offer.
        offer: OfferId,
        /// How many messages wait at most.
        depth: u16,
    },
    /// Do not want it any more.
    Unwant {
        /// From whom.
        peer: GatewayId,
        /// The number of its offer.
        offer: OfferId,
    },
    /// Show the domain what comes from there: a publisher, or a server.
    Show {
        /// What.
        subject: Subject,
        /// From which gateway's domain.
        origin: GatewayId,
        /// By which peer.
        peer: GatewayId,
    },
    /// Do not show it any more.
    Hide {
        /// What.
        subject: Subject,
        /// From which gateway's domain.
        origin: GatewayId,
    },
    /// Take what the domain's publishers publish, or be a client of its servers.
    Subscribe {
        /// What.
        subject: Subject,
        /// How many messages wait for a peer at most.
        depth: u16,
    },
    /// Do not any more.
    Unsubscribe {
        /// What.
        subject: Subject,
    },
}
