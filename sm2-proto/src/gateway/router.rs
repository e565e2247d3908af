//! Decides which offers a gateway makes, uses and passes on: SPEC sections 14.3 and 14.6.
//!
//! [`Router`] keeps the contract of [`Machine`]. It never ends, and no input is a misuse. Each input
//! changes one fact: the rules, a connection, or something about one source of a subject. The router
//! then *settles* the source: it computes anew what follows from all facts that hold now, and its
//! outputs are the differences from what followed before. So the result does not depend on the order
//! of the inputs.
//!
//! Other rules and a new connection concern all sources. The router settles them in pieces of at most
//! [`PIECE_DECISIONS`]: the first one at once, and one at each [`Input::Tick`]. A source that is used
//! in between is settled first, by [`Input::Use`].

mod input;
mod source;
mod walk;

use alloc::{
    collections::{BTreeMap, BTreeSet, VecDeque},
    vec::Vec,
};
use core::convert::Infallible;

pub use self::input::{Input, Output, Source};
use self::{
    source::{Rank, Route, SourceState},
    walk::{Key, Sources, Walk},
};
use super::{Direction, GatewayId, Hop, OfferId, Rules, Subject};
use crate::{Instant, Machine, MisuseError, limits::HOPS_MAX, machine::debug_assert_drained};

/// The most decisions of the rules in one piece, apart from those for the last source of the piece.
pub const PIECE_DECISIONS: usize = 512;

/// The most offers with which debug builds check the indexes of offers.
const CHECKED_OFFERS_MAX: usize = 256;

/// The machine that computes the routes of one gateway.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub struct Router {
    me: Hop,
    rules: Rules,
    /// The connected peers, each with the number of the last offer to it.
    peers: BTreeMap<GatewayId, OfferId>,
    sources: Sources,
    /// The sources of the offers of peers, with their ranks, and of those to them, by the numbers of the
    /// offers.
    peer_offers: BTreeMap<(GatewayId, OfferId), (Key, Rank)>,
    own_offers: BTreeMap<(GatewayId, OfferId), Key>,
    /// The walk over all sources, until it is over.
    walk: Option<Walk>,
    outputs: VecDeque<Output>,
}

impl Router {
    /// A router without peers and subjects.
    #[must_use]
    pub fn new(me: Hop, rules: Rules) -> Self {
        Self {
            me,
            rules,
            peers: BTreeMap::new(),
            sources: BTreeMap::new(),
            peer_offers: BTreeMap::new(),
            own_offers: BTreeMap::new(),
            walk: None,
            outputs: VecDeque::new(),
        }
    }

    fn input(&mut self, now: Instant, input: Input) {
        match input {
            Input::Rules(rules) => {
                self.rules = rules;
                self.settle_all(now);
            }
            Input::Up { peer } => {
                self.down(peer);
                self.peers.insert(peer, OfferId(0));
                self.settle_all(now);
            }
            Input::Down { peer } => self.down(peer),
            Input::Local { subject, present } => {
                self.state(&subject, Source::Local).local = present;
                self.settle(&subject, Source::Local);
            }
            Input::Taken {
                subject,
                origin,
                taken,
            } => {
                let source = Source::Remote(origin);
                self.state(&subject, source).local_demand = taken;
                self.settle(&subject, source);
            }
            Input::Offered {
                peer,
                offer,
                subject,
                path,
            } => self.offered(peer, offer, subject, path),
            Input::Gone { peer, offer } => {
                if let Some(((subject, source), rank)) = self.peer_offers.remove(&(peer, offer)) {
                    self.state(&subject, source).gone(peer, rank);
                    self.settle(&subject, source);
                }
            }
            Input::Wanted { peer, offer, depth } => self.wanted(peer, offer, Some(depth)),
            Input::Unwanted { peer, offer } => self.wanted(peer, offer, None),
            Input::Use { subject, source } => {
                if self.walk.is_some() {
                    self.settle(&subject, source);
                }
            }
            Input::Tick => self.settle_piece(),
        }
    }

    /// The peers that want a source of a subject, each with the number of the offer to it. A message
    /// of the source goes to all of them.
    pub fn takers(
        &self,
        subject: &Subject,
        source: Source,
    ) -> impl Iterator<Item = (GatewayId, OfferId)> {
        let state = self.sources.get(subject).and_then(|it| it.get(&source));
        state.into_iter().flat_map(SourceState::takers)
    }

    /// The subjects of which the own domain has publishers or servers.
    pub fn local(&self) -> impl Iterator<Item = &Subject> {
        let is_local =
            |it: &BTreeMap<Source, SourceState>| it.get(&Source::Local).is_some_and(|it| it.local);
        let local = self.sources.iter().filter(move |(_, it)| is_local(it));
        local.map(|(subject, _)| subject)
    }

    /// The subject and the source of an own offer.
    #[must_use]
    pub fn source(&self, peer: GatewayId, offer: OfferId) -> Option<(&Subject, Source)> {
        let (subject, source) = self.own_offers.get(&(peer, offer))?;
        Some((subject, *source))
    }

    fn state(&mut self, subject: &Subject, source: Source) -> &mut SourceState {
        let sources = self.sources.entry(subject.clone()).or_default();
        sources.entry(source).or_default()
    }

    fn offered(&mut self, peer: GatewayId, offer: OfferId, subject: Subject, path: Vec<Hop>) {
        let is_new = !self.peer_offers.contains_key(&(peer, offer));
        let Some(origin) = path.first().map(|it| it.gateway) else {
            return;
        };
        if is_new && self.peers.contains_key(&peer) {
            let (source, rank) = (Source::Remote(origin), Rank::new(offer, &path));
            self.state(&subject, source).offered(peer, rank, path);
            let key = (subject.clone(), source);
            self.peer_offers.insert((peer, offer), (key, rank));
            self.settle(&subject, source);
        }
    }

    fn wanted(&mut self, peer: GatewayId, offer: OfferId, depth: Option<u16>) {
        if let Some((subject, source)) = self.own_offers.get(&(peer, offer)).cloned() {
            self.state(&subject, source).wanted(peer, depth);
            self.settle(&subject, source);
        }
    }

    /// Ends the connection with a peer: removes all offers of and to it.
    fn down(&mut self, peer: GatewayId) {
        if self.peers.remove(&peer).is_none() {
            return;
        }
        let offers = (peer, OfferId(0))..=(peer, OfferId(u64::MAX));
        let theirs = self.peer_offers.range(offers.clone());
        let ours = self.own_offers.range(offers);
        let (mut ended, mut concerned) = (Vec::new(), BTreeSet::new());
        for (id, key) in theirs.map(|(id, (key, _))| (id, key)).chain(ours) {
            ended.push(*id);
            concerned.insert(key.clone());
        }
        for id in &ended {
            self.peer_offers.remove(id);
            self.own_offers.remove(id);
        }
        for (subject, source) in concerned {
            self.state(&subject, source).forget(peer);
            self.settle(&subject, source);
        }
    }

    /// Begins to settle all sources, and settles the first piece of them.
    fn settle_all(&mut self, now: Instant) {
        match &mut self.walk {
            Some(walk) => walk.start_over(),
            None => self.walk = Some(Walk::new(now)),
        }
        self.settle_piece();
    }

    /// Settles the next sources of the walk.
    //= SM2-GWR-005
    fn settle_piece(&mut self) {
        let mut decisions = 0;
        while decisions < PIECE_DECISIONS {
            let Some(walk) = &mut self.walk else { return };
            let Some((subject, source)) = walk.next(&self.sources) else {
                self.walk = None;
                return;
            };
            decisions += self.settle(&subject, source);
        }
    }

    /// Computes what follows from the facts about a source, and outputs the differences. Returns the cost in
    /// decisions of the rules. SPEC, Annex B.11 has the same steps.
    //= SM2-GWO-003, SM2-GWO-004, SM2-GWR-003
    fn settle(&mut self, subject: &Subject, source: Source) -> usize {
        let (rules, outputs) = (&self.rules, &mut self.outputs);
        let sources = self.sources.get_mut(subject);
        let Some(state) = sources.and_then(|it| it.get_mut(&source)) else {
            return 1;
        };
        let decisions = state.decisions(self.peers.len());
        let (kind, name) = (subject.kind(), subject.name());
        let allows = |direction, peer: &GatewayId| rules.allow(kind, name, direction, peer);
        let route = state.best_route(|peer| allows(Direction::In, peer));
        let route_id = route.map(Route::id);
        let path = match source {
            Source::Local => state.local.then(|| Vec::from([self.me])),
            Source::Remote(_) => route.map(|it| it.path.iter().copied().chain([self.me]).collect()),
        };
        let path = path.filter(|it: &Vec<Hop>| it.len() <= HOPS_MAX);
        let withdrawn =
            state.withdraw(|peer, of| path.as_ref() == Some(of) && allows(Direction::Out, peer));
        for (peer, offer) in withdrawn {
            self.own_offers.remove(&(peer, offer));
            outputs.push_back(Output::Unoffer { peer, offer });
        }
        if let Some(path) = path {
            let offer_to = |peer: &GatewayId| allows(Direction::Out, peer);
            let made = state.make_offers(&path, &mut self.peers, offer_to);
            for (peer, offer) in made {
                let key = (subject.clone(), source);
                self.own_offers.insert((peer, offer), key);
                outputs.push_back(Output::Offer {
                    peer,
                    offer,
                    subject: subject.clone(),
                    path: path.clone(),
                });
            }
        }
        match source {
            Source::Local => state.subscribe(subject, outputs),
            Source::Remote(origin) => {
                let is_open = |it: &_| self.peer_offers.contains_key(it);
                state.use_route((subject, origin), route_id, is_open, outputs);
            }
        }
        if state.is_idle() {
            self.remove(subject, source);
        }
        decisions
    }

    fn remove(&mut self, subject: &Subject, source: Source) {
        if let Some(sources) = self.sources.get_mut(subject) {
            sources.remove(&source);
            if sources.is_empty() {
                self.sources.remove(subject);
            }
        }
    }

    /// Both indexes of offers agree with the sources. Checked only while there are few offers, because the check
    /// visits all of them.
    fn invariants(&self) {
        if self.peer_offers.len() + self.own_offers.len() > CHECKED_OFFERS_MAX {
            return;
        }
        let sources = || self.sources.values().flat_map(BTreeMap::values);
        let peer_offers = sources().map(SourceState::peer_offers_len);
        debug_assert_eq!(peer_offers.sum::<usize>(), self.peer_offers.len());
        let own_offers = sources().map(SourceState::own_offers_len);
        debug_assert_eq!(own_offers.sum::<usize>(), self.own_offers.len());
    }
}

impl Machine for Router {
    type Input<'a> = Input;
    type Output = Output;
    type End = Infallible;
    type Misuse = Infallible;

    /// Feeds one input. It is always legal.
    fn handle(&mut self, now: Instant, input: Input) -> Result<(), MisuseError<Infallible>> {
        if !matches!(input, Input::Taken { .. }) {
            debug_assert_drained(&self.outputs);
        }
        self.input(now, input);
        self.invariants();
        Ok(())
    }

    fn poll(&mut self) -> Option<Output> {
        self.outputs.pop_front()
    }

    /// The time at which the walk over all sources began, as long as some are left.
    fn deadline(&self) -> Option<Instant> {
        self.walk.as_ref().map(|it| it.since)
    }
}
