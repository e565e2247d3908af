//! Topics and services: the interfaces on each side, and the types.

#[cfg(any(kani, test))]
mod proofs;

use alloc::{
    collections::{BTreeMap, btree_map::Entry},
    sync::Arc,
};
use core::ops::Bound;

use crate::{Contract, EntityId, Kind, Name, Refusal, TypeId, match_contracts, matching::Types};

/// Topics and services are two separate name spaces.
//= SM2-NAM-002
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
enum Space {
    Topic,
    Service,
}

/// The hash comes first, so that a search compares numbers that stand in the tree and not texts
/// that stand elsewhere. Names with the same hash differ in the third part.
type Key = (u64, Space, Name);

/// The interfaces on one topic or service.
#[derive(Clone, Debug, Default, PartialEq, Eq, Hash)]
pub(super) struct Channel {
    /// Publishers or servers.
    offering: BTreeMap<EntityId, Arc<Contract>>,
    /// Subscribers or clients.
    demanding: BTreeMap<EntityId, Arc<Contract>>,
    /// The number of interfaces that state a type.
    typed: usize,
    /// The type that all of these interfaces state.
    types: Option<Stated>,
}

/// The types of a topic or service.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
enum Stated {
    Topic(TypeId),
    Service(TypeId, TypeId),
}

#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub(super) struct Channels(BTreeMap<Key, Channel>);

impl Channels {
    pub(super) const fn new() -> Self {
        Self(BTreeMap::new())
    }

    /// The channel of this contract, if any interface is on it.
    pub(super) fn get(&self, contract: &Contract) -> Option<&Channel> {
        self.0.get(&key(contract))
    }

    pub(super) fn insert(&mut self, end: EntityId, contract: &Arc<Contract>) {
        let channel = self.0.entry(key(contract)).or_default();
        if let Some(types) = contract.types() {
            channel.typed += 1;
            channel.types.get_or_insert_with(|| types.into());
        }
        channel
            .side_mut(contract.kind())
            .insert(end, Arc::clone(contract));
    }

    pub(super) fn remove(&mut self, end: EntityId, contract: &Contract) {
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

    /// The number of channels.
    pub(super) fn len(&self) -> usize {
        self.0.len()
    }

    /// The number of interfaces on all channels together, by a recount.
    pub(super) fn ends(&self) -> usize {
        let channels = self.0.values();
        channels
            .map(|it| it.offering.len() + it.demanding.len())
            .sum()
    }

    /// Whether each channel holds exactly what its interfaces require.
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
    /// A channel has one type as long as any of its interfaces states one.
    //= SM2-IFC-005
    pub(super) fn refuse_types(&self, contract: &Contract) -> Result<(), Refusal> {
        match (&self.types, contract.types()) {
            (Some(Stated::Topic(theirs)), Some(ours)) if ours != Types::Topic(theirs) => {
                Err(Refusal::TopicType {
                    theirs: theirs.clone(),
                })
            }
            (Some(Stated::Service(request, reply)), Some(ours))
                if ours != Types::Service(request, reply) =>
            {
                Err(Refusal::ServiceType {
                    request: request.clone(),
                    reply: reply.clone(),
                })
            }
            _ => Ok(()),
        }
    }

    /// The interfaces that match, in ascending order.
    pub(super) fn matches(&self, contract: &Contract) -> impl Iterator<Item = EntityId> {
        let all = self.counterparts(contract, EntityId::FIRST);
        all.filter_map(|(end, matches)| matches.then_some(end))
    }

    /// The interfaces on the other side after an id, in ascending order, and whether they match.
    //= SM2-MAT-001
    pub(super) fn counterparts(
        &self,
        contract: &Contract,
        after: EntityId,
    ) -> impl Iterator<Item = (EntityId, bool)> {
        let others = self.side(contract.kind().counterpart());
        let rest = others.range((Bound::Excluded(after), Bound::Unbounded));
        rest.map(|(&end, theirs)| (end, match_contracts(contract, theirs).is_ok()))
    }

    /// The number of interfaces on the other side of an interface of this kind.
    pub(super) fn counterpart_count(&self, kind: Kind) -> usize {
        self.side(kind.counterpart()).len()
    }

    /// Whether a publisher or server with a lower id is there.
    pub(super) fn has_offering_before(&self, entity: EntityId) -> bool {
        let first = self.offering.first_key_value();
        first.is_some_and(|(&first, _)| first < entity)
    }

    const fn side(&self, kind: Kind) -> &BTreeMap<EntityId, Arc<Contract>> {
        match kind {
            Kind::Publisher | Kind::Server => &self.offering,
            Kind::Subscriber | Kind::Client => &self.demanding,
        }
    }

    const fn side_mut(&mut self, kind: Kind) -> &mut BTreeMap<EntityId, Arc<Contract>> {
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
    let name = contract.name();
    // FNV-1a
    let hash = name
        .as_str()
        .bytes()
        .fold(0xcbf2_9ce4_8422_2325, |hash: u64, byte| {
            (hash ^ u64::from(byte)).wrapping_mul(0x0100_0000_01b3)
        });
    (hash, space, name.clone())
}

impl From<Types<'_>> for Stated {
    fn from(types: Types<'_>) -> Self {
        match types {
            Types::Topic(data) => Self::Topic(data.clone()),
            Types::Service(request, reply) => Self::Service(request.clone(), reply.clone()),
        }
    }
}
