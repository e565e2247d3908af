//! Decides which offers a gateway makes, uses and passes on: SPEC sections 14.3 and 14.6.
//!
//! [`Router`] keeps the contract of [`Machine`]. It never ends, and no input is a misuse. Each input
//! changes one fact: the rules, a connection, or something about one source of a subject. The router
//! then *updates* the source: it computes anew what follows from all facts that hold now, and its
//! outputs are the differences from what followed before. So the result does not depend on the order
//! of the inputs.
//!
//! Other rules and a new connection concern all sources; the end of a connection concerns those of its
//! offers. The router updates them in pieces of at most [`PIECE_DECISIONS`]: the first one at once, and
//! one at each [`Input::Tick`]. A source that is used in between is updated first, by [`Input::Use`].
//!
//! A route is a whole path, not a next hop: an offer lists the gateways that it came through, and is not made to any of
//! them. No other rule is needed to prevent cycles. Of several paths to one origin, one is used, so that no message
//! arrives twice.

mod connections;
mod input;
mod source;
mod walk;

use alloc::{
    collections::{BTreeMap, VecDeque},
    vec::Vec,
};
use core::convert::Infallible;

pub use self::input::{Input, Output, Source};
use self::{
    connections::{Connection, Connections},
    source::{Rank, Route, RouteId, SourceState},
    walk::{Key, Sources, Walk},
};
use super::{Direction, GatewayId, Hop, OfferId, Rules, Subject};
use crate::{Instant, Machine, MisuseError, limits::HOPS_MAX, machine::debug_assert_drained};

/// The most decisions of the rules in one piece, apart from those for the last source of the piece.
pub const PIECE_DECISIONS: usize = 512;

/// The most offers that debug builds still check the indexes of offers with.
const CHECKED_OFFERS_MAX: usize = 256;

/// The machine that computes the routes of one gateway.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub struct Router {
    me: Hop,
    rules: Rules,
    connections: Connections,
    sources: Sources,
    /// The sources of the offers of peers, with their ranks, and of those to them, by connection and number.
    peer_offers: BTreeMap<RouteId, (Key, Rank)>,
    own_offers: BTreeMap<RouteId, Key>,
    /// The walk over all sources, until it is over.
    walk: Option<Walk>,
    /// The time since when sources are left to update.
    outdated_since: Option<Instant>,
    outputs: VecDeque<Output>,
}

impl Router {
    /// A router without peers and subjects.
    #[must_use]
    pub fn new(me: Hop, rules: Rules) -> Self {
        Self {
            me,
            rules,
            connections: Connections::default(),
            sources: BTreeMap::new(),
            peer_offers: BTreeMap::new(),
            own_offers: BTreeMap::new(),
            walk: None,
            outdated_since: None,
            outputs: VecDeque::new(),
        }
    }

    fn input(&mut self, now: Instant, input: Input) {
        match input {
            Input::Rules(rules) => {
                self.rules = rules;
                self.update_all(now);
            }
            Input::Up { peer } => {
                self.connections.open(peer);
                self.update_all(now);
            }
            Input::Down { peer } => {
                if self.connections.end(peer) {
                    self.begin(now);
                }
            }
            Input::Local { subject, present } => {
                self.state(&subject, Source::Local).local = present;
                self.update(&subject, Source::Local);
            }
            Input::Taken {
                subject,
                origin,
                taken,
            } => {
                let source = Source::Remote(origin);
                self.state(&subject, source).local_demand = taken;
                self.update(&subject, source);
            }
            Input::Offered {
                peer,
                offer,
                subject,
                path,
            } => self.offered(peer, offer, subject, path),
            Input::Gone { peer, offer } => {
                let from = self.connections.with(peer);
                if let Some((key, _)) = from.and_then(|from| self.remove_offer(from, offer)) {
                    self.update(&key.0, key.1);
                }
            }
            Input::Wanted { peer, offer, depth } => self.wanted(peer, offer, Some(depth)),
            Input::Unwanted { peer, offer } => self.wanted(peer, offer, None),
            Input::Use { subject, source } => {
                if self.outdated_since.is_some() {
                    self.update(&subject, source);
                }
            }
            Input::Tick => self.update_piece(),
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
        let wanting = state
            .into_iter()
            .flat_map(|it| it.wanting(&self.connections));
        wanting.map(|(peer, offer, _)| (peer, offer))
    }

    /// The subjects with publishers or servers in the own domain.
    pub fn local(&self) -> impl Iterator<Item = &Subject> {
        let is_local =
            |it: &BTreeMap<Source, SourceState>| it.get(&Source::Local).is_some_and(|it| it.local);
        let local = self.sources.iter().filter(move |(_, it)| is_local(it));
        local.map(|(subject, _)| subject)
    }

    /// The subject and the source of an own offer.
    #[must_use]
    pub fn source(&self, peer: GatewayId, offer: OfferId) -> Option<(&Subject, Source)> {
        let connection = self.connections.with(peer)?;
        let (subject, source) = self.own_offers.get(&(connection, offer))?;
        Some((subject, *source))
    }

    fn state(&mut self, subject: &Subject, source: Source) -> &mut SourceState {
        let sources = self.sources.entry(subject.clone()).or_default();
        sources.entry(source).or_default()
    }

    fn offered(&mut self, peer: GatewayId, offer: OfferId, subject: Subject, path: Vec<Hop>) {
        let Some(from) = self.connections.with(peer) else {
            return;
        };
        let is_new = !self.peer_offers.contains_key(&(from, offer));
        let Some(origin) = path.first().map(|it| it.gateway) else {
            return;
        };
        if is_new {
            let (source, rank) = (Source::Remote(origin), Rank::new(offer, &path));
            self.state(&subject, source).offered(from, rank, path);
            let key = (subject.clone(), source);
            self.peer_offers.insert((from, offer), (key, rank));
            self.update(&subject, source);
        }
    }

    fn wanted(&mut self, peer: GatewayId, offer: OfferId, depth: Option<u16>) {
        let by = self.connections.with(peer);
        let own_offer = by.and_then(|by| Some((by, self.own_offers.get(&(by, offer))?.clone())));
        if let Some((by, (subject, source))) = own_offer {
            self.state(&subject, source).wanted(by, depth);
            self.update(&subject, source);
        }
    }

    /// Removes an offer of a peer. Returns its source, and whether the source has no other offer of the connection.
    fn remove_offer(&mut self, from: Connection, offer: OfferId) -> Option<(Key, bool)> {
        let (key, rank) = self.peer_offers.remove(&(from, offer))?;
        let is_last = self.state(&key.0, key.1).gone(from, rank);
        Some((key, is_last))
    }

    /// Begins to update all sources, and updates the first piece of them.
    fn update_all(&mut self, now: Instant) {
        self.walk.get_or_insert_default().start_over();
        self.begin(now);
    }

    /// Updates the first piece of the sources that are left.
    fn begin(&mut self, now: Instant) {
        self.outdated_since.get_or_insert(now);
        self.update_piece();
    }

    /// Updates the next sources that are left: those of connections that have ended, then those of the walk.
    //= SM2-GWR-004, SM2-GWO-008
    fn update_piece(&mut self) {
        let mut decisions = 0;
        while decisions < PIECE_DECISIONS {
            if let Some(ended) = self.connections.first_ended() {
                decisions += self.end_next(ended);
                continue;
            }
            let next = self.walk.as_mut().and_then(|it| it.next(&self.sources));
            let Some((subject, source)) = next else {
                self.walk = None;
                self.outdated_since = None;
                return;
            };
            decisions += self.update(&subject, source);
        }
    }

    /// Removes one offer of a connection that has ended, or the connection if no offer is left. Returns the cost in
    /// decisions of the rules.
    fn end_next(&mut self, ended: Connection) -> usize {
        let offers = (ended, OfferId(0))..=(ended, OfferId(u64::MAX));
        if let Some((&(_, offer), _)) = self.peer_offers.range(offers.clone()).next() {
            return match self.remove_offer(ended, offer) {
                Some(((subject, source), true)) => self.update(&subject, source),
                // The source is updated with the last one of its offers.
                _ => 1,
            };
        }
        let own_offer = self.own_offers.range(offers).next();
        let Some((id, (subject, source))) = own_offer.map(|(id, key)| (*id, key.clone())) else {
            self.connections.forget(ended);
            return 1;
        };
        self.own_offers.remove(&id);
        self.state(&subject, source).ended(ended);
        self.update(&subject, source)
    }

    /// Computes what follows from the facts about a source, and outputs the differences. Returns the cost in
    /// decisions of the rules. SPEC, Annex B.11 has the same steps.
    //= SM2-GWO-003, SM2-GWO-004, SM2-GWR-003
    fn update(&mut self, subject: &Subject, source: Source) -> usize {
        let (rules, outputs) = (&self.rules, &mut self.outputs);
        let sources = self.sources.get_mut(subject);
        let Some(state) = sources.and_then(|it| it.get_mut(&source)) else {
            return 1;
        };
        let decisions = state.decisions(&self.connections);
        let (kind, name) = (subject.kind(), subject.name());
        let allows = |direction, peer: &GatewayId| rules.allow(kind, name, direction, peer);
        let is_open = |it: &Connection| self.connections.is_open(it);
        let route = state.best_route(|it| is_open(it) && allows(Direction::In, &it.peer));
        let route_id = route.map(Route::id);
        let path = match source {
            Source::Local => state.local.then(|| Vec::from([self.me])),
            Source::Remote(_) => route.map(|it| it.path.iter().copied().chain([self.me]).collect()),
        };
        let path = path.filter(|it: &Vec<Hop>| it.len() <= HOPS_MAX);
        let withdrawn = state.withdraw(is_open, |peer, of| {
            path.as_ref() == Some(of) && allows(Direction::Out, peer)
        });
        for (connection, offer) in withdrawn {
            self.own_offers.remove(&(connection, offer));
            let peer = connection.peer;
            outputs.push_back(Output::Unoffer { peer, offer });
        }
        if let Some(path) = path {
            let offer_to = |peer: &GatewayId| allows(Direction::Out, peer);
            let made = state.make_offers(&path, &mut self.connections, offer_to);
            for (connection, offer) in made {
                let key = (subject.clone(), source);
                self.own_offers.insert((connection, offer), key);
                outputs.push_back(Output::Offer {
                    peer: connection.peer,
                    offer,
                    subject: subject.clone(),
                    path: path.clone(),
                });
            }
        }
        match source {
            Source::Local => state.subscribe(subject, &self.connections, outputs),
            Source::Remote(origin) => {
                let connections = &self.connections;
                let is_offered =
                    |it: &RouteId| connections.is_open(&it.0) && self.peer_offers.contains_key(it);
                let subject = (subject, origin);
                state.use_route(subject, route_id, connections, is_offered, outputs);
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

    /// The time since when sources are left to update.
    fn deadline(&self) -> Option<Instant> {
        self.outdated_since
    }
}
