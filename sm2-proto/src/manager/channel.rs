//! Topics and services: who stands on which side of each, and its types.

use alloc::{
    collections::{BTreeMap, btree_map::Entry},
    vec::Vec,
};

use super::links::End;
use crate::{Contract, Kind, Name, Refusal, TypeId, match_contracts, matching::Types};

/// Topics and services are two separate name spaces.
//= SM2-NAM-002
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
enum Space {
    Topic,
    Service,
}

type Key = (Space, Name);

/// The interfaces on one topic or service.
#[derive(Clone, Debug, Default, PartialEq, Eq, Hash)]
struct Channel {
    /// Publishers or servers.
    offering: BTreeMap<End, Contract>,
    /// Subscribers or clients.
    demanding: BTreeMap<End, Contract>,
    /// How many of them state a type.
    typed: usize,
    /// The type that all of those state.
    types: Option<Vec<TypeId>>,
}

#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub(super) struct Channels(BTreeMap<Key, Channel>);

impl Channels {
    pub(super) const fn new() -> Self {
        Self(BTreeMap::new())
    }

    /// A channel has one type as long as anybody there states one.
    //= SM2-IFC-005
    pub(super) fn refuse_types(&self, contract: &Contract) -> Result<(), Refusal> {
        let channel = self.0.get(&key(contract));
        let Some(theirs) = channel.and_then(|channel| channel.types.as_deref()) else {
            return Ok(());
        };
        let same = contract.types().is_none_or(|ours| ours.to_vec() == theirs);
        match theirs {
            _ if same => Ok(()),
            [request, reply] => Err(Refusal::ServiceType {
                request: request.clone(),
                reply: reply.clone(),
            }),
            [theirs, ..] => Err(Refusal::TopicType {
                theirs: theirs.clone(),
            }),
            [] => Ok(()),
        }
    }

    /// The interfaces that match, in ascending order.
    //= SM2-MAT-001
    pub(super) fn matches(&self, contract: &Contract) -> impl Iterator<Item = End> {
        let channel = self.0.get(&key(contract));
        let others = channel.map(|channel| channel.side(contract.kind().counterpart()));
        let matching = others
            .into_iter()
            .flatten()
            .filter(|(_, theirs)| match_contracts(contract, theirs).is_ok());
        matching.map(|(&end, _)| end)
    }

    pub(super) fn insert(&mut self, end: End, contract: &Contract) {
        let channel = self.0.entry(key(contract)).or_default();
        if let Some(types) = contract.types() {
            channel.typed += 1;
            channel.types.get_or_insert_with(|| types.to_vec());
        }
        channel
            .side_mut(contract.kind())
            .insert(end, contract.clone());
    }

    pub(super) fn remove(&mut self, end: End, contract: &Contract) {
        let Entry::Occupied(mut entry) = self.0.entry(key(contract)) else {
            return;
        };
        let channel = entry.get_mut();
        if channel.side_mut(contract.kind()).remove(&end).is_none() {
            return;
        }
        if contract.types().is_some() {
            channel.typed -= 1;
        }
        if channel.typed == 0 {
            channel.types = None;
        }
        if channel.offering.is_empty() && channel.demanding.is_empty() {
            entry.remove();
        }
    }

    /// How many interfaces stand on all channels together, by a recount.
    pub(super) fn ends(&self) -> usize {
        let channels = self.0.values();
        channels
            .map(|it| it.offering.len() + it.demanding.len())
            .sum()
    }

    /// Whether there is no more of a channel than its interfaces ask for.
    pub(super) fn are_tight(&self) -> bool {
        self.0.values().all(|it| {
            let ends = it.offering.values().chain(it.demanding.values());
            let typed = ends.filter(|contract| contract.types().is_some()).count();
            let empty = it.offering.is_empty() && it.demanding.is_empty();
            !empty && it.typed == typed && it.types.is_some() == (typed > 0)
        })
    }
}

impl Channel {
    const fn side(&self, kind: Kind) -> &BTreeMap<End, Contract> {
        match kind {
            Kind::Publisher | Kind::Server => &self.offering,
            Kind::Subscriber | Kind::Client => &self.demanding,
        }
    }

    const fn side_mut(&mut self, kind: Kind) -> &mut BTreeMap<End, Contract> {
        match kind {
            Kind::Publisher | Kind::Server => &mut self.offering,
            Kind::Subscriber | Kind::Client => &mut self.demanding,
        }
    }
}

fn key(contract: &Contract) -> Key {
    let space = match contract.kind() {
        Kind::Publisher | Kind::Subscriber => Space::Topic,
        Kind::Server | Kind::Client => Space::Service,
    };
    (space, contract.name().clone())
}

impl Types<'_> {
    fn to_vec(&self) -> Vec<TypeId> {
        match *self {
            Self::Topic(data) => [data].map(TypeId::clone).into(),
            Self::Service(request, reply) => [request, reply].map(TypeId::clone).into(),
        }
    }
}
