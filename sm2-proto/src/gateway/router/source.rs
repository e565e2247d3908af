//! The facts about one source of a topic or service, and what the router has told others about it.

use alloc::{
    collections::{BTreeMap, VecDeque},
    vec::Vec,
};
use core::cmp::Reverse;

use super::{
    super::{GatewayId, Hop, OfferId, Subject},
    Output,
};

#[derive(Clone, Debug, Default, PartialEq, Eq, Hash)]
pub(super) struct SourceState {
    // The facts.
    /// True if the source is the own domain, and it has publishers or servers.
    pub(super) local: bool,
    /// How many messages wait for those in the own domain that take the messages of another origin; `None` if
    /// nobody takes them.
    pub(super) local_demand: Option<u16>,
    /// The offers of each peer, with their paths. The first one of a peer is the best.
    peer_offers: BTreeMap<GatewayId, BTreeMap<Rank, Vec<Hop>>>,
    /// The offers to peers.
    own_offers: BTreeMap<GatewayId, OwnOffer>,
    // The outputs that are in effect.
    /// The peer through which the messages come that the proxy in the own domain publishes.
    proxy: Option<GatewayId>,
    /// The offer of a peer that this gateway wants.
    wanted_offer: Option<(GatewayId, OfferId)>,
    /// The depth of the subscription in the own domain, if there is one.
    subscribed: Option<u16>,
}

/// The order of preference among the offers of one peer; the least rank is used.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub(super) struct Rank {
    epoch: Reverse<u64>,
    path_len: usize,
    offer: OfferId,
}

/// An offer to a peer.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
struct OwnOffer {
    offer: OfferId,
    path: Vec<Hop>,
    /// The depth that the peer wants, if it wants the offer.
    wanted: Option<u16>,
}

/// The one offer of a peer that is used.
#[derive(Clone, Copy, Debug)]
pub(super) struct Route<'a> {
    peer: GatewayId,
    offer: OfferId,
    pub(super) path: &'a Vec<Hop>,
}

/// The peer and the number of the offer of a route.
pub(super) type RouteId = (GatewayId, OfferId);

impl SourceState {
    /// Chooses the offer to use.
    //= SM2-GWO-004
    pub(super) fn best_route(
        &self,
        may_come_from: impl Fn(&GatewayId) -> bool,
    ) -> Option<Route<'_>> {
        let first = |(&peer, offers): (&GatewayId, &'_ BTreeMap<Rank, Vec<Hop>>)| {
            let rank = *offers.first_key_value()?.0;
            Some((rank.epoch, rank.path_len, peer, rank))
        };
        let allowed = self
            .peer_offers
            .iter()
            .filter(|(peer, _)| may_come_from(peer));
        let (.., peer, rank) = allowed.filter_map(first).min()?;
        let path = self.peer_offers.get(&peer)?.get(&rank)?;
        let offer = rank.offer;
        Some(Route { peer, offer, path })
    }

    /// Adds an offer of a peer.
    pub(super) fn offered(&mut self, peer: GatewayId, rank: Rank, path: Vec<Hop>) {
        self.peer_offers.entry(peer).or_default().insert(rank, path);
    }

    /// Removes an offer that a peer has withdrawn.
    pub(super) fn gone(&mut self, peer: GatewayId, rank: Rank) {
        if let Some(offers) = self.peer_offers.get_mut(&peer) {
            offers.remove(&rank);
            if offers.is_empty() {
                self.peer_offers.remove(&peer);
            }
        }
    }

    /// Removes the own offers that are out of date and returns their numbers.
    pub(super) fn withdraw(
        &mut self,
        may_stay: impl Fn(&GatewayId, &Vec<Hop>) -> bool,
    ) -> Vec<(GatewayId, OfferId)> {
        let mut withdrawn = Vec::new();
        self.own_offers.retain(|peer, our| {
            let stays = may_stay(peer, &our.path);
            if !stays {
                withdrawn.push((*peer, our.offer));
            }
            stays
        });
        withdrawn
    }

    /// Makes an offer to each of the `peers` that has none and is not on the path. Returns the numbers.
    pub(super) fn make_offers(
        &mut self,
        path: &[Hop],
        peers: &mut BTreeMap<GatewayId, OfferId>,
        may_go_to: impl Fn(&GatewayId) -> bool,
    ) -> Vec<(GatewayId, OfferId)> {
        let mut made = Vec::new();
        for (&peer, last) in peers {
            let comes_from = path.iter().any(|it| it.gateway == peer);
            if comes_from || self.own_offers.contains_key(&peer) || !may_go_to(&peer) {
                continue;
            }
            last.0 += 1;
            let our = OwnOffer {
                offer: *last,
                path: path.to_vec(),
                wanted: None,
            };
            self.own_offers.insert(peer, our);
            made.push((peer, *last));
        }
        made
    }

    /// Declares the proxy of another origin in the own domain, and wants the route if there is demand. It ends the
    /// old route before it begins the new one, so that no message comes by two routes. `is_open` tells whether the
    /// offer of the old route still exists.
    pub(super) fn use_route(
        &mut self,
        (subject, origin): (&Subject, GatewayId),
        route: Option<RouteId>,
        is_open: impl Fn(&RouteId) -> bool,
        outputs: &mut VecDeque<Output>,
    ) {
        let comes_from = route.map(|(peer, _)| peer);
        if self.proxy.is_some() && self.proxy != comes_from {
            self.proxy = None;
            // Subscribers of the domain have subscribed to the proxy that is withdrawn now.
            self.local_demand = None;
            outputs.push_back(Output::WithdrawProxy {
                subject: subject.clone(),
                origin,
            });
        }
        let demand = self.demand();
        let wanted = route.filter(|_| demand.is_some());
        if let Some(before) = self.wanted_offer.filter(|it| wanted != Some(*it)) {
            self.wanted_offer = None;
            if is_open(&before) {
                let (peer, offer) = before;
                outputs.push_back(Output::Unwant { peer, offer });
            }
        }
        if let Some(peer) = comes_from.filter(|_| self.proxy.is_none()) {
            self.proxy = comes_from;
            outputs.push_back(Output::DeclareProxy {
                subject: subject.clone(),
                origin,
                peer,
            });
        }
        if let Some(((peer, offer), depth)) = wanted.zip(demand)
            && self.wanted_offer.is_none()
        {
            self.wanted_offer = wanted;
            outputs.push_back(Output::Want { peer, offer, depth });
        }
    }

    /// Subscribes in the own domain while a peer wants its messages.
    pub(super) fn subscribe(&mut self, subject: &Subject, outputs: &mut VecDeque<Output>) {
        let demand = self.demand().filter(|_| self.local);
        let before = core::mem::replace(&mut self.subscribed, demand);
        if before == demand {
            return;
        }
        let subject = subject.clone();
        outputs.push_back(match demand {
            Some(depth) => Output::Subscribe { subject, depth },
            None => Output::Unsubscribe { subject },
        });
    }

    /// The greatest depth that anybody wants; `None` if nobody wants the source.
    fn demand(&self) -> Option<u16> {
        let wanted = self.own_offers.values().filter_map(|it| it.wanted);
        wanted.chain(self.local_demand).max()
    }

    pub(super) fn wanted(&mut self, peer: GatewayId, depth: Option<u16>) {
        if let Some(our) = self.own_offers.get_mut(&peer) {
            our.wanted = depth;
        }
    }

    pub(super) fn takers(&self) -> impl Iterator<Item = (GatewayId, OfferId)> {
        let wanted = self.own_offers.iter().filter(|(_, it)| it.wanted.is_some());
        wanted.map(|(peer, it)| (*peer, it.offer))
    }

    /// Removes all offers of and to a peer whose connection has ended.
    pub(super) fn forget(&mut self, peer: GatewayId) {
        self.peer_offers.remove(&peer);
        self.own_offers.remove(&peer);
    }

    pub(super) fn peer_offers_len(&self) -> usize {
        self.peer_offers.values().map(BTreeMap::len).sum()
    }

    pub(super) fn own_offers_len(&self) -> usize {
        self.own_offers.len()
    }

    /// Whether the state is the same as that of an unknown source.
    pub(super) fn is_idle(&self) -> bool {
        *self == Self::default()
    }

    /// The cost of settling the source, in decisions of the rules: one for each offer, each peer that has made one
    /// and each of the `peers`.
    pub(super) fn decisions(&self, peers: usize) -> usize {
        1 + self.peer_offers.len() + self.own_offers.len() + peers
    }
}

impl Rank {
    pub(super) fn new(offer: OfferId, path: &[Hop]) -> Self {
        Self {
            epoch: Reverse(path.first().map_or(0, |it| it.epoch)),
            path_len: path.len(),
            offer,
        }
    }
}

impl Route<'_> {
    pub(super) const fn id(self) -> RouteId {
        (self.peer, self.offer)
    }
}
