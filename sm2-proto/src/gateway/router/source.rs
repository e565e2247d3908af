//! The facts about one source of a topic or service, and what the router has told others about it.

use alloc::{
    collections::{BTreeMap, VecDeque},
    vec::Vec,
};
use core::cmp::Reverse;

use super::{
    super::{GatewayId, Hop, OfferId, Subject},
    Output,
    connections::{Connection, Connections},
};

/// The facts about a source, and the outputs that are in effect. Offers of a connection that has ended stay until
/// the router removes them one by one; nothing follows from them, so each function that judges offers asks which
/// connections are open.

#[derive(Clone, Debug, Default, PartialEq, Eq, Hash)]
pub(super) struct SourceState {
    // The facts.
    /// True if the source is the own domain, and it has publishers or servers.
    pub(super) local: bool,
    /// How many messages wait for those in the own domain that take the messages of another origin; `None` if
    /// nobody takes them.
    pub(super) local_demand: Option<u16>,
    /// The offers of each connection, with their paths. The first one of a connection is the best.
    peer_offers: BTreeMap<Connection, BTreeMap<Rank, Vec<Hop>>>,
    /// The offers to peers.
    own_offers: BTreeMap<Connection, OwnOffer>,
    // The outputs that are in effect.
    /// The peer through which the messages come that the proxy in the own domain publishes.
    proxy: Option<GatewayId>,
    /// The offer of a peer that this gateway wants.
    wanted_offer: Option<RouteId>,
    /// The depth of the subscription in the own domain, if there is one.
    subscribed: Option<u16>,
}

/// The order of preference among the offers of one connection; the least rank is used.
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
    connection: Connection,
    offer: OfferId,
    pub(super) path: &'a Vec<Hop>,
}

/// The connection and the number of the offer of a route.
pub(super) type RouteId = (Connection, OfferId);

impl SourceState {
    /// Chooses the offer to use, of connections that are open and allowed.
    //= SM2-GWO-004
    pub(super) fn best_route(
        &self,
        may_come_by: impl Fn(&Connection) -> bool,
    ) -> Option<Route<'_>> {
        let first = |(&connection, offers): (&Connection, &'_ BTreeMap<Rank, Vec<Hop>>)| {
            let rank = *offers.first_key_value()?.0;
            Some((rank.epoch, rank.path_len, connection, rank))
        };
        let allowed = (self.peer_offers.iter()).filter(|(connection, _)| may_come_by(connection));
        let (.., connection, rank) = allowed.filter_map(first).min()?;
        let path = self.peer_offers.get(&connection)?.get(&rank)?;
        let offer = rank.offer;
        Some(Route {
            connection,
            offer,
            path,
        })
    }

    /// Adds an offer of a peer.
    pub(super) fn offered(&mut self, from: Connection, rank: Rank, path: Vec<Hop>) {
        self.peer_offers.entry(from).or_default().insert(rank, path);
    }

    /// Removes an offer that a peer has withdrawn, or whose connection has ended. False if other offers of the
    /// connection are left.
    pub(super) fn gone(&mut self, from: Connection, rank: Rank) -> bool {
        let Some(offers) = self.peer_offers.get_mut(&from) else {
            return true;
        };
        offers.remove(&rank);
        let is_last = offers.is_empty();
        if is_last {
            self.peer_offers.remove(&from);
        }
        is_last
    }

    /// Removes the own offer on a connection that has ended.
    pub(super) fn ended(&mut self, connection: Connection) {
        self.own_offers.remove(&connection);
    }

    /// Removes the own offers on open connections that are out of date, and returns their numbers.
    pub(super) fn withdraw(
        &mut self,
        is_open: impl Fn(&Connection) -> bool,
        may_stay: impl Fn(&GatewayId, &Vec<Hop>) -> bool,
    ) -> Vec<(Connection, OfferId)> {
        let mut withdrawn = Vec::new();
        self.own_offers.retain(|connection, our| {
            let stays = !is_open(connection) || may_stay(&connection.peer, &our.path);
            if !stays {
                withdrawn.push((*connection, our.offer));
            }
            stays
        });
        withdrawn
    }

    /// Makes an offer on each open connection that has none and whose peer is not on the path. Returns the numbers.
    pub(super) fn make_offers(
        &mut self,
        path: &[Hop],
        connections: &mut Connections,
        may_go_to: impl Fn(&GatewayId) -> bool,
    ) -> Vec<(Connection, OfferId)> {
        let mut made = Vec::new();
        for (connection, last) in connections.iter_mut() {
            let peer = connection.peer;
            let comes_from = path.iter().any(|it| it.gateway == peer);
            if comes_from || self.own_offers.contains_key(&connection) || !may_go_to(&peer) {
                continue;
            }
            last.0 += 1;
            let our = OwnOffer {
                offer: *last,
                path: path.to_vec(),
                wanted: None,
            };
            self.own_offers.insert(connection, our);
            made.push((connection, *last));
        }
        made
    }

    /// Declares the proxy of another origin in the own domain, and wants the route if there is demand. It ends the
    /// old route before it begins the new one, so that no message comes by two routes. `is_offered` tells whether
    /// an offer of a peer exists on an open connection.
    pub(super) fn use_route(
        &mut self,
        (subject, origin): (&Subject, GatewayId),
        route: Option<RouteId>,
        connections: &Connections,
        is_offered: impl Fn(&RouteId) -> bool,
        outputs: &mut VecDeque<Output>,
    ) {
        let comes_from = route.map(|(connection, _)| connection.peer);
        if self.proxy.is_some() && self.proxy != comes_from {
            self.proxy = None;
            // Subscribers of the domain have subscribed to the proxy that is withdrawn now.
            self.local_demand = None;
            outputs.push_back(Output::WithdrawProxy {
                subject: subject.clone(),
                origin,
            });
        }
        let demand = self.demand(connections);
        let wanted = route.filter(|_| demand.is_some());
        if let Some(before) = self.wanted_offer.filter(|it| wanted != Some(*it)) {
            self.wanted_offer = None;
            if is_offered(&before) {
                let (connection, offer) = before;
                let peer = connection.peer;
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
        if let Some(((connection, offer), depth)) = wanted.zip(demand)
            && self.wanted_offer.is_none()
        {
            self.wanted_offer = wanted;
            let peer = connection.peer;
            outputs.push_back(Output::Want { peer, offer, depth });
        }
    }

    /// Subscribes in the own domain while a peer wants its messages.
    pub(super) fn subscribe(
        &mut self,
        subject: &Subject,
        connections: &Connections,
        outputs: &mut VecDeque<Output>,
    ) {
        let demand = self.demand(connections).filter(|_| self.local);
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
    fn demand(&self, connections: &Connections) -> Option<u16> {
        let wanted = self.wanting(connections).map(|(.., depth)| depth);
        wanted.chain(self.local_demand).max()
    }

    pub(super) fn wanted(&mut self, by: Connection, depth: Option<u16>) {
        if let Some(our) = self.own_offers.get_mut(&by) {
            our.wanted = depth;
        }
    }

    /// The peers that want the source, each with the number of the offer to it and the depth.
    pub(super) fn wanting(
        &self,
        connections: &Connections,
    ) -> impl Iterator<Item = (GatewayId, OfferId, u16)> {
        let open =
            (self.own_offers.iter()).filter(|(connection, _)| connections.is_open(connection));
        open.filter_map(|(connection, it)| Some((connection.peer, it.offer, it.wanted?)))
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

    /// The cost of updating the source, in decisions of the rules: one for each own offer, each connection with
    /// offers of its peer and each open connection.
    pub(super) fn decisions(&self, connections: &Connections) -> usize {
        1 + self.peer_offers.len() + self.own_offers.len() + connections.len()
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
        (self.connection, self.offer)
    }
}
