//! The facts about one topic or service, and what the router has told others about it.

use alloc::{
    collections::{BTreeMap, VecDeque},
    vec::Vec,
};
use core::cmp::Reverse;

use super::{
    super::{GatewayId, Hop, OfferId, Subject},
    Output, Source,
};
use crate::limits::HOPS_MAX;

#[derive(Clone, Debug, Default, PartialEq, Eq, Hash)]
pub(super) struct SubjectState {
    // The facts.
    /// Whether the own domain has publishers or servers.
    pub(super) local: bool,
    /// For each origin whose messages somebody in the own domain takes: how many of them wait.
    pub(super) local_demand: BTreeMap<GatewayId, u16>,
    /// The offers of peers, with their paths.
    pub(super) peer_offers: BTreeMap<(GatewayId, OfferId), Vec<Hop>>,
    /// The offers to peers.
    own_offers: BTreeMap<(GatewayId, Source), OwnOffer>,
    // The outputs that are in effect.
    /// The origins that have a proxy in the own domain, each with the peer through which it comes.
    proxies: BTreeMap<GatewayId, GatewayId>,
    /// The offers of peers that this gateway wants, by origin.
    wanted_offers: BTreeMap<GatewayId, (GatewayId, OfferId)>,
    /// The depth of the subscription in the own domain, if there is one.
    subscribed: Option<u16>,
}

/// An offer to a peer.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
struct OwnOffer {
    offer: OfferId,
    path: Vec<Hop>,
    /// The depth that the peer wants, if it wants the offer.
    wanted: Option<u16>,
}

/// The one offer that is used of an origin.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct Route {
    peer: GatewayId,
    offer: OfferId,
    path: Vec<Hop>,
}

impl SubjectState {
    /// Chooses the offer to use for each origin.
    //= SM2-GWO-004
    pub(super) fn best_routes(
        &self,
        may_come_from: impl Fn(&GatewayId) -> bool,
    ) -> BTreeMap<GatewayId, Route> {
        let mut best: BTreeMap<GatewayId, Route> = BTreeMap::new();
        for (&(peer, offer), path) in &self.peer_offers {
            let Some(origin) = path.first().filter(|_| may_come_from(&peer)) else {
                continue;
            };
            let route = Route {
                peer,
                offer,
                path: path.clone(),
            };
            let is_better = |than: &Route| route.rank() < than.rank();
            if best.get(&origin.gateway).is_none_or(is_better) {
                best.insert(origin.gateway, route);
            }
        }
        best
    }

    /// The sources that can be offered to peers, each with its path up to this gateway.
    pub(super) fn sources(
        &self,
        routes: &BTreeMap<GatewayId, Route>,
        me: Hop,
    ) -> BTreeMap<Source, Vec<Hop>> {
        let local = self.local.then(|| (Source::Local, Vec::from([me])));
        let remote = routes.iter().map(|(&origin, route)| {
            let path = route.path.iter().copied().chain([me]).collect();
            (Source::Remote(origin), path)
        });
        let is_short = |(_, path): &(Source, Vec<Hop>)| path.len() <= HOPS_MAX;
        local.into_iter().chain(remote).filter(is_short).collect()
    }

    /// Removes the own offers that are out of date and returns their numbers.
    pub(super) fn withdraw(
        &mut self,
        may_stay: impl Fn(&GatewayId, Source, &Vec<Hop>) -> bool,
    ) -> Vec<(GatewayId, OfferId)> {
        let mut withdrawn = Vec::new();
        self.own_offers.retain(|(peer, source), our| {
            let stays = may_stay(peer, *source, &our.path);
            if !stays {
                withdrawn.push((*peer, our.offer));
            }
            stays
        });
        withdrawn
    }

    pub(super) fn is_offered(&self, peer: GatewayId, source: Source) -> bool {
        self.own_offers.contains_key(&(peer, source))
    }

    pub(super) fn offer(
        &mut self,
        peer: GatewayId,
        source: Source,
        offer: OfferId,
        path: Vec<Hop>,
    ) {
        let our = OwnOffer {
            offer,
            path,
            wanted: None,
        };
        self.own_offers.insert((peer, source), our);
    }

    /// Declares proxies of the routes in the own domain, and wants those for which there is demand. It ends the old
    /// ones before it begins new ones, so that no message comes by two routes.
    pub(super) fn use_routes(
        &mut self,
        subject: &Subject,
        routes: &BTreeMap<GatewayId, Route>,
        outputs: &mut VecDeque<Output>,
    ) {
        self.proxies.retain(|origin, peer| {
            let stays = routes.get(origin).is_some_and(|it| it.peer == *peer);
            if !stays {
                // Subscribers of the domain have subscribed to the proxy that is withdrawn now.
                self.local_demand.remove(origin);
                outputs.push_back(Output::WithdrawProxy {
                    subject: subject.clone(),
                    origin: *origin,
                });
            }
            stays
        });
        let wanted = routes.iter().filter_map(|(&origin, route)| {
            let depth = self.demand(Source::Remote(origin))?;
            Some((origin, (route.peer, route.offer, depth)))
        });
        let wanted: BTreeMap<_, _> = wanted.collect();
        self.wanted_offers.retain(|origin, &mut (peer, offer)| {
            let is_it = |it: &(GatewayId, OfferId, u16)| (it.0, it.1) == (peer, offer);
            let stays = wanted.get(origin).is_some_and(is_it);
            if !stays && self.peer_offers.contains_key(&(peer, offer)) {
                outputs.push_back(Output::Unwant { peer, offer });
            }
            stays
        });
        for (&origin, route) in routes {
            let peer = route.peer;
            if self.proxies.insert(origin, peer).is_none() {
                outputs.push_back(Output::DeclareProxy {
                    subject: subject.clone(),
                    origin,
                    peer,
                });
            }
        }
        for (origin, (peer, offer, depth)) in wanted {
            if self.wanted_offers.insert(origin, (peer, offer)).is_none() {
                outputs.push_back(Output::Want { peer, offer, depth });
            }
        }
    }

    /// Subscribes in the own domain while a peer wants its messages.
    pub(super) fn subscribe(&mut self, subject: &Subject, outputs: &mut VecDeque<Output>) {
        let demand = self.demand(Source::Local).filter(|_| self.local);
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

    /// The greatest depth that anybody wants of a source; `None` if nobody wants it.
    fn demand(&self, source: Source) -> Option<u16> {
        let here = match source {
            Source::Local => None,
            Source::Remote(origin) => self.local_demand.get(&origin).copied(),
        };
        let wanted = self.own_offers.iter().filter(|((_, of), _)| *of == source);
        wanted.filter_map(|(_, it)| it.wanted).chain(here).max()
    }

    pub(super) fn wanted(&mut self, peer: GatewayId, offer: OfferId, depth: Option<u16>) {
        let is_it = |((to, _), it): &(&(GatewayId, Source), &mut OwnOffer)| {
            *to == peer && it.offer == offer
        };
        if let Some((_, our)) = self.own_offers.iter_mut().find(is_it) {
            our.wanted = depth;
        }
    }

    pub(super) fn takers(&self, source: Source) -> impl Iterator<Item = (GatewayId, OfferId)> {
        let wanted = self.own_offers.iter();
        let wanted = wanted.filter(move |((_, of), it)| *of == source && it.wanted.is_some());
        wanted.map(|((peer, _), it)| (*peer, it.offer))
    }

    pub(super) fn source(&self, peer: GatewayId, offer: OfferId) -> Option<Source> {
        let mut own_offers = self.own_offers.iter();
        let found = own_offers.find(|((to, _), it)| *to == peer && it.offer == offer);
        found.map(|((_, source), _)| *source)
    }

    /// Removes an offer that a peer has withdrawn.
    pub(super) fn gone(&mut self, offer: (GatewayId, OfferId)) {
        self.peer_offers.remove(&offer);
    }

    /// Removes all offers of and to a peer whose connection has ended.
    pub(super) fn forget(&mut self, peer: GatewayId) {
        self.peer_offers.retain(|(of, _), _| *of != peer);
        self.own_offers.retain(|(to, _), _| *to != peer);
    }

    pub(super) fn own_offers_len(&self) -> usize {
        self.own_offers.len()
    }

    /// Whether the state is the same as that of an unknown subject.
    pub(super) fn is_idle(&self) -> bool {
        *self == Self::default()
    }
}

impl Route {
    /// The order of preference; the least rank is used.
    fn rank(&self) -> (Reverse<u64>, usize, GatewayId, OfferId) {
        let epoch = self.path.first().map_or(0, |it| it.epoch);
        (Reverse(epoch), self.path.len(), self.peer, self.offer)
    }
}
