//! Decides which offers a gateway makes, uses and passes on: SPEC sections 14.3 and 14.6.
//!
//! [`Router`] keeps the contract of [`Machine`]. It has no timer, never ends, and no input is a
//! misuse. Each input changes one fact: the rules, a connection, or something about one subject.
//! The router then computes anew what follows for the subject from all facts that hold now, and
//! its outputs are the differences from what followed before. So the result does not depend on
//! the order of the inputs.

mod input;
mod subject;

use alloc::{
    collections::{BTreeMap, VecDeque},
    vec::Vec,
};
use core::convert::Infallible;

pub use self::input::{Input, Output, Source};
use self::subject::SubjectState;
use super::{Direction, GatewayId, Hop, OfferId, Rules, Subject};
use crate::{Instant, Machine, MisuseError, machine::debug_assert_drained};

/// The machine that computes the routes of one gateway.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub struct Router {
    me: Hop,
    rules: Rules,
    /// The connected peers, each with the number of the last offer to it.
    peers: BTreeMap<GatewayId, OfferId>,
    subjects: BTreeMap<Subject, SubjectState>,
    /// The subjects of the offers of peers, and of those to them, by the numbers of the offers.
    peer_offers: BTreeMap<(GatewayId, OfferId), Subject>,
    own_offers: BTreeMap<(GatewayId, OfferId), Subject>,
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
            subjects: BTreeMap::new(),
            peer_offers: BTreeMap::new(),
            own_offers: BTreeMap::new(),
            outputs: VecDeque::new(),
        }
    }

    fn input(&mut self, input: Input) {
        match input {
            Input::Rules(rules) => {
                self.rules = rules;
                self.settle_all();
            }
            Input::Up { peer } => {
                self.down(peer);
                self.peers.insert(peer, OfferId(0));
                self.settle_all();
            }
            Input::Down { peer } => self.down(peer),
            Input::Local { subject, present } => {
                self.subject(&subject).local = present;
                self.settle(&subject);
            }
            Input::Taken {
                subject,
                origin,
                taken,
            } => {
                let state = self.subject(&subject);
                match taken {
                    Some(depth) => state.local_demand.insert(origin, depth),
                    None => state.local_demand.remove(&origin),
                };
                self.settle(&subject);
            }
            Input::Offered {
                peer,
                offer,
                subject,
                path,
            } => {
                let is_new = !self.peer_offers.contains_key(&(peer, offer));
                if is_new && self.peers.contains_key(&peer) && !path.is_empty() {
                    self.peer_offers.insert((peer, offer), subject.clone());
                    self.subject(&subject)
                        .peer_offers
                        .insert((peer, offer), path);
                    self.settle(&subject);
                }
            }
            Input::Gone { peer, offer } => {
                if let Some(subject) = self.peer_offers.remove(&(peer, offer)) {
                    self.subject(&subject).gone((peer, offer));
                    self.settle(&subject);
                }
            }
            Input::Wanted { peer, offer, depth } => self.wanted(peer, offer, Some(depth)),
            Input::Unwanted { peer, offer } => self.wanted(peer, offer, None),
        }
    }

    /// The peers that want a source of a subject, each with the number of the offer to it. A message
    /// of the source goes to all of them.
    pub fn takers(
        &self,
        subject: &Subject,
        source: Source,
    ) -> impl Iterator<Item = (GatewayId, OfferId)> {
        let state = self.subjects.get(subject);
        state.into_iter().flat_map(move |it| it.takers(source))
    }

    /// The subjects of which the own domain has publishers or servers.
    pub fn local(&self) -> impl Iterator<Item = &Subject> {
        let local = self.subjects.iter().filter(|(_, it)| it.local);
        local.map(|(subject, _)| subject)
    }

    /// The subject and the source of an own offer.
    #[must_use]
    pub fn source(&self, peer: GatewayId, offer: OfferId) -> Option<(&Subject, Source)> {
        let subject = self.own_offers.get(&(peer, offer))?;
        let source = self.subjects.get(subject)?.source(peer, offer)?;
        Some((subject, source))
    }

    fn subject(&mut self, subject: &Subject) -> &mut SubjectState {
        self.subjects.entry(subject.clone()).or_default()
    }

    fn wanted(&mut self, peer: GatewayId, offer: OfferId, depth: Option<u16>) {
        if let Some(subject) = self.own_offers.get(&(peer, offer)).cloned() {
            self.subject(&subject).wanted(peer, offer, depth);
            self.settle(&subject);
        }
    }

    /// Ends the connection with a peer: removes all offers of and to it.
    fn down(&mut self, peer: GatewayId) {
        if self.peers.remove(&peer).is_none() {
            return;
        }
        self.peer_offers.retain(|(of, _), _| *of != peer);
        self.own_offers.retain(|(to, _), _| *to != peer);
        for state in self.subjects.values_mut() {
            state.forget(peer);
        }
        self.settle_all();
    }

    fn settle_all(&mut self) {
        let all: Vec<Subject> = self.subjects.keys().cloned().collect();
        for subject in &all {
            self.settle(subject);
        }
    }

    /// Computes what follows from the facts about a subject, and outputs the differences. SPEC, Annex
    /// B.11 has the same steps.
    //= SM2-GWO-003, SM2-GWO-004, SM2-GWR-003
    fn settle(&mut self, subject: &Subject) {
        let Some(mut state) = self.subjects.remove(subject) else {
            return;
        };
        let (kind, name) = (subject.kind(), subject.name());
        let allows = |direction, peer: &GatewayId| self.rules.allow(kind, name, direction, peer);
        let routes = state.best_routes(|peer| allows(Direction::In, peer));
        let sources = state.sources(&routes, self.me);
        let withdrawn = state.withdraw(|peer, source, path| {
            sources.get(&source) == Some(path) && allows(Direction::Out, peer)
        });
        for (peer, offer) in withdrawn {
            self.own_offers.remove(&(peer, offer));
            self.outputs.push_back(Output::Unoffer { peer, offer });
        }
        for (&source, path) in &sources {
            for (peer, last) in &mut self.peers {
                let comes_from = path.iter().any(|it| it.gateway == *peer);
                if comes_from || !allows(Direction::Out, peer) || state.is_offered(*peer, source) {
                    continue;
                }
                last.0 += 1;
                let (peer, offer) = (*peer, *last);
                state.offer(peer, source, offer, path.clone());
                self.own_offers.insert((peer, offer), subject.clone());
                self.outputs.push_back(Output::Offer {
                    peer,
                    offer,
                    subject: subject.clone(),
                    path: path.clone(),
                });
            }
        }
        state.use_routes(subject, &routes, &mut self.outputs);
        state.subscribe(subject, &mut self.outputs);
        if !state.is_idle() {
            self.subjects.insert(subject.clone(), state);
        }
    }

    /// Both indexes of offers agree with the subjects.
    fn invariants(&self) {
        let peer_offers = self.subjects.values().map(|it| it.peer_offers.len());
        debug_assert_eq!(peer_offers.sum::<usize>(), self.peer_offers.len());
        let own_offers = self.subjects.values().map(SubjectState::own_offers_len);
        debug_assert_eq!(own_offers.sum::<usize>(), self.own_offers.len());
    }
}

impl Machine for Router {
    type Input<'a> = Input;
    type Output = Output;
    type End = Infallible;
    type Misuse = Infallible;

    /// Feeds one input. It is always legal; `now` is not used.
    fn handle(&mut self, _now: Instant, input: Input) -> Result<(), MisuseError<Infallible>> {
        if !matches!(input, Input::Taken { .. }) {
            debug_assert_drained(&self.outputs);
        }
        self.input(input);
        self.invariants();
        Ok(())
    }

    fn poll(&mut self) -> Option<Output> {
        self.outputs.pop_front()
    }

    /// Always `None`: routes have no timer.
    fn deadline(&self) -> Option<Instant> {
        None
    }
}
