//! One topic or service: what is so, and what was said of it.

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
    /// Whether the domain has publishers or servers of its own.
    pub(super) local: bool,
    /// Who in the domain takes what comes from an origin: how many messages wait at most.
    pub(super) taken: BTreeMap<GatewayId, u16>,
    /// The offers of peers: the path of each.
    pub(super) theirs: BTreeMap<(GatewayId, OfferId), Vec<Hop>>,
    ours: BTreeMap<(GatewayId, Source), Our>,
    /// What the domain is shown: by origin, from which peer.
    shown: BTreeMap<GatewayId, GatewayId>,
    /// The offers that are wanted, by origin.
    wanting: BTreeMap<GatewayId, (GatewayId, OfferId)>,
    /// Whether the domain's own are taken, and how many messages wait at most.
    subscribed: Option<u16>,
}

/// An offer to a peer.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
struct Our {
    offer: OfferId,
    path: Vec<Hop>,
    wanted: Option<u16>,
}

/// The offer that is used of an origin.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct Route {
    peer: GatewayId,
    offer: OfferId,
    path: Vec<Hop>,
}

impl SubjectState {
    /// Of each origin the offer that is used.
    //= SM2-GWO-004
    pub(super) fn best_routes(
        &self,
        may_come_from: impl Fn(&GatewayId) -> bool,
    ) -> BTreeMap<GatewayId, Route> {
        let mut best: BTreeMap<GatewayId, Route> = BTreeMap::new();
        for (&(peer, offer), path) in &self.theirs {
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

    /// What can be offered: by source, with the path that it has from here.
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

    /// Forgets the offers that may not be made like this any more; gives their numbers.
    pub(super) fn withdraw(
        &mut self,
        may_stay: impl Fn(&GatewayId, Source, &Vec<Hop>) -> bool,
    ) -> Vec<(GatewayId, OfferId)> {
        let mut withdrawn = Vec::new();
        self.ours.retain(|(peer, source), our| {
            let stays = may_stay(peer, *source, &our.path);
            if !stays {
                withdrawn.push((*peer, our.offer));
            }
            stays
        });
        withdrawn
    }

    pub(super) fn is_offered(&self, peer: GatewayId, source: Source) -> bool {
        self.ours.contains_key(&(peer, source))
    }

    pub(super) fn offer(
        &mut self,
        peer: GatewayId,
        source: Source,
        offer: OfferId,
        path: Vec<Hop>,
    ) {
        let our = Our {
            offer,
            path,
            wanted: None,
        };
        self.ours.insert((peer, source), our);
    }

    /// Shows the domain what can come, and wants what somebody takes. What ends comes first, so
    /// that nothing comes by two ways.
    pub(super) fn use_routes(
        &mut self,
        subject: &Subject,
        routes: &BTreeMap<GatewayId, Route>,
        outputs: &mut VecDeque<Output>,
    ) {
        self.shown.retain(|origin, peer| {
            let stays = routes.get(origin).is_some_and(|it| it.peer == *peer);
            if !stays {
                // Whoever took it took it from what is hidden now.
                self.taken.remove(origin);
                outputs.push_back(Output::Hide {
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
        self.wanting.retain(|origin, &mut (peer, offer)| {
            let is_it = |it: &(GatewayId, OfferId, u16)| (it.0, it.1) == (peer, offer);
            let stays = wanted.get(origin).is_some_and(is_it);
            if !stays && self.theirs.contains_key(&(peer, offer)) {
                outputs.push_back(Output::Unwant { peer, offer });
            }
            stays
        });
        for (&origin, route) in routes {
            let peer = route.peer;
            if self.shown.insert(origin, peer).is_none() {
                outputs.push_back(Output::Show {
                    subject: subject.clone(),
                    origin,
                    peer,
                });
            }
        }
        for (origin, (peer, offer, depth)) in wanted {
            if self.wanting.insert(origin, (peer, offer)).is_none() {
                outputs.push_back(Output::Want { peer, offer, depth });
            }
        }
    }

    /// Takes the domain's own while some peer wants them.
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

    /// How many messages of a source wait at most for whoever wants them, if somebody does.
    fn demand(&self, source: Source) -> Option<u16> {
        let here = match source {
            Source::Local => None,
            Source::Remote(origin) => self.taken.get(&origin).copied(),
        };
        let wanted = self.ours.iter().filter(|((_, of), _)| *of == source);
        wanted.filter_map(|(_, it)| it.wanted).chain(here).max()
    }

    pub(super) fn wanted(&mut self, peer: GatewayId, offer: OfferId, depth: Option<u16>) {
        let is_it =
            |((to, _), it): &(&(GatewayId, Source), &mut Our)| *to == peer && it.offer == offer;
        if let Some((_, our)) = self.ours.iter_mut().find(is_it) {
            our.wanted = depth;
        }
    }

    pub(super) fn takers(&self, source: Source) -> impl Iterator<Item = (GatewayId, OfferId)> {
        let wanted = self.ours.iter();
        let wanted = wanted.filter(move |((_, of), it)| *of == source && it.wanted.is_some());
        wanted.map(|((peer, _), it)| (*peer, it.offer))
    }

    pub(super) fn source(&self, peer: GatewayId, offer: OfferId) -> Option<Source> {
        let mut ours = self.ours.iter();
        let found = ours.find(|((to, _), it)| *to == peer && it.offer == offer);
        found.map(|((_, source), _)| *source)
    }

    /// A peer does not offer this any more.
    pub(super) fn gone(&mut self, theirs: (GatewayId, OfferId)) {
        self.theirs.remove(&theirs);
    }

    /// There is no connection with this peer any more.
    pub(super) fn forget(&mut self, peer: GatewayId) {
        self.theirs.retain(|(of, _), _| *of != peer);
        self.ours.retain(|(to, _), _| *to != peer);
    }

    pub(super) fn offers(&self) -> usize {
        self.ours.len()
    }

    /// Whether nothing is to be remembered.
    pub(super) fn is_idle(&self) -> bool {
        *self == Self::default()
    }
}

impl Route {
    /// The least one is used.
    fn rank(&self) -> (Reverse<u64>, usize, GatewayId, OfferId) {
        let epoch = self.path.first().map_or(0, |it| it.epoch);
        (Reverse(epoch), self.path.len(), self.peer, self.offer)
    }
}
