//! One connection: whose it is, how far it has come, what it declared.

#[cfg(any(kani, test))]
mod proofs;

use alloc::{
    collections::{BTreeMap, BTreeSet},
    sync::Arc,
    vec::Vec,
};
use core::ops::Bound;

use super::{Credentials, Policy, STANDBY_PREFIX, links::Pair, phase::Phase, policy::within};
use crate::{
    Contract, EntityId, Instant, InterfaceId, LinkId, Name, NodeId, Quota, Refusal, TypeId,
    Violation, control::Item, limits::LINKS_MAX,
};

#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub(super) struct Session {
    credentials: Credentials,
    /// Known once the session is welcomed.
    name: Option<Name>,
    /// As long as it is resuming.
    resumption: Option<Resumption>,
    /// As long as there are pairs that nobody has looked at since.
    settling: Option<Settling>,
    last_interface: u64,
    interfaces: BTreeMap<InterfaceId, Interface>,
    /// What was refused lately, and why.
    refused: BTreeMap<InterfaceId, (Contract, Refusal)>,
    /// How many LINKs it was sent since its socket last had taken all that was sent to it.
    pub(super) ahead: usize,
    /// How many ends of links all interfaces have together.
    link_ends: usize,
    /// When its claims are given up, if it has claimed all that it has and some of it
    /// had no counterpart.
    pub(super) claims_until: Option<Instant>,
    /// Whether the driver keeps the file of its counters.
    pub(super) has_counters: bool,
    /// The types whose texts it registered, and what they cost.
    schemas: BTreeSet<TypeId>,
    schema_bytes: usize,
}

/// What counts until CLAIMED.
#[derive(Clone, Debug, Default, PartialEq, Eq, Hash)]
struct Resumption {
    /// How many claims came.
    claims: usize,
    /// UnlinkedPairs whose adopted links ended again: they are not linked anew.
    ended: BTreeSet<Pair>,
}

/// What is still to be linked of a session that has claimed all that it has (SM2-RES-007).
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
struct Settling {
    /// Which interface comes next, and after which of its counterparts.
    next: (InterfaceId, EntityId),
    /// The last interface that was there at CLAIMED.
    last: InterfaceId,
    /// UnlinkedPairs that are not linked anew.
    ended: BTreeSet<Pair>,
}

#[derive(Clone, Debug, PartialEq, Eq, Hash)]
struct Interface {
    /// Shared with its channel.
    contract: Arc<Contract>,
    /// The links of which nobody has taken leave, and whom each joins; none as long as
    /// the other end has not claimed it.
    live: BTreeMap<LinkId, Option<Pair>>,
    /// Those for which UNLINK was sent and UNLINKED has not come.
    told: BTreeSet<LinkId>,
}

/// What is left of an interface: its contract and its live links.
pub(super) type Remains = (Arc<Contract>, BTreeMap<LinkId, Option<Pair>>);

/// How far the farewells of a link's end have come when the node says its own
/// (SM2-LNK-003).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Farewells {
    /// The node is first and has to be answered. Whom the link joined.
    First(Option<Pair>),
    /// UNLINK was sent before: both are said.
    Both,
}

impl Session {
    pub(super) const fn new(credentials: Credentials) -> Self {
        Self {
            credentials,
            name: None,
            resumption: None,
            settling: None,
            last_interface: 0,
            interfaces: BTreeMap::new(),
            refused: BTreeMap::new(),
            ahead: 0,
            link_ends: 0,
            claims_until: None,
            has_counters: false,
            schemas: BTreeSet::new(),
            schema_bytes: 0,
        }
    }

    pub(super) const fn credentials(&self) -> Credentials {
        self.credentials
    }

    pub(super) const fn phase(&self) -> Phase {
        match (&self.name, &self.resumption) {
            (None, _) => Phase::Greeting,
            (Some(_), Some(_)) => Phase::Resuming,
            (Some(_), None) => Phase::Ready,
        }
    }

    pub(super) const fn is_welcomed(&self) -> bool {
        self.name.is_some()
    }

    pub(super) const fn name(&self) -> Option<&Name> {
        self.name.as_ref()
    }

    /// Whether it is a Manager that waits for the end of this one.
    pub(super) fn is_standby(&self) -> bool {
        (self.name()).is_some_and(|name| name.as_str().starts_with(STANDBY_PREFIX))
    }

    pub(super) fn welcome(&mut self, name: Name, resuming: bool) {
        self.name = Some(name);
        self.resumption = resuming.then(Resumption::default);
    }

    /// All is claimed. What is there now is to be linked as far as it is not.
    pub(super) fn settle(&mut self) {
        self.settling = Some(Settling {
            next: (InterfaceId(0), EntityId::FIRST),
            last: InterfaceId(self.last_interface),
            ended: self.resumption.take().unwrap_or_default().ended,
        });
    }

    /// Whether there are pairs of it that nobody has looked at since it claimed all it has.
    pub(super) const fn is_settling(&self) -> bool {
        self.settling.is_some()
    }

    /// The next interface to be linked, and after which counterpart. None once all are.
    pub(super) fn unsettled(&mut self, node: NodeId) -> Option<(EntityId, EntityId)> {
        let Settling { next, last, .. } = self.settling.as_ref()?;
        let following = self.interfaces.range(next.0..).next();
        let Some((&interface, _)) = following.filter(|(id, _)| *id <= last) else {
            self.settling = None;
            return None;
        };
        let begun = next.0 == interface;
        let after = if begun { next.1 } else { EntityId::FIRST };
        Some((EntityId { node, interface }, after))
    }

    /// So far this has come: up to a counterpart of an interface, or to its last one.
    pub(super) fn settled(&mut self, interface: InterfaceId, up_to: Option<EntityId>) {
        if let Some(settling) = &mut self.settling {
            settling.next = match up_to {
                Some(counterpart) => (interface, counterpart),
                None => (InterfaceId(interface.0.saturating_add(1)), EntityId::FIRST),
            };
        }
    }

    /// Whether a pair that is not settled has ended its link.
    pub(super) fn has_ended(&self, pair: Pair) -> bool {
        let settling = self.settling.as_ref();
        settling.is_some_and(|it| it.ended.contains(&pair))
    }

    /// Spends an interface number.
    //= SM2-IFC-001
    pub(super) fn number(&mut self, interface: InterfaceId) -> Result<(), Violation> {
        if interface.0 <= self.last_interface {
            return Err(violation!(InterfaceNumber, "SM2-IFC-001"));
        }
        self.last_interface = interface.0;
        Ok(())
    }

    pub(super) fn refuse_interface(&self, policy: &Policy) -> Result<(), Refusal> {
        let limit = policy.interfaces_per_session;
        within(limit, self.interfaces() + 1, Quota::InterfacesPerSession)
    }

    pub(super) fn interfaces(&self) -> usize {
        self.interfaces.len()
    }

    pub(super) fn interface_ids(&self) -> Vec<InterfaceId> {
        self.interfaces.keys().copied().collect()
    }

    pub(super) fn contract(&self, interface: InterfaceId) -> Option<&Arc<Contract>> {
        Some(&self.interfaces.get(&interface)?.contract)
    }

    /// An interface or refusal as an item.
    pub(super) fn member(&self, entity: EntityId) -> Option<Item> {
        if let Some(contract) = self.contract(entity.interface) {
            return Some(interface(entity, contract));
        }
        let refused = self.refused.get(&entity.interface)?;
        Some(refusal(entity, refused))
    }

    /// The interfaces and refusals after an id, in ascending order.
    pub(super) fn members(&self, after: EntityId) -> impl Iterator<Item = Item> {
        let at = move |interface| EntityId { interface, ..after };
        let rest = (Bound::Excluded(after.interface), Bound::Unbounded);
        let mut granted = self.interfaces.range(rest).peekable();
        let mut refused = self.refused.range(rest).peekable();
        core::iter::from_fn(move || {
            let granted_is_next = match (granted.peek(), refused.peek()) {
                (Some((one, _)), Some((other, _))) => one < other,
                (one, _) => one.is_some(),
            };
            if granted_is_next {
                let (&id, it) = granted.next()?;
                Some(interface(at(id), &it.contract))
            } else {
                let (&id, it) = refused.next()?;
                Some(refusal(at(id), it))
            }
        })
    }

    pub(super) fn declare(&mut self, interface: InterfaceId, contract: Arc<Contract>) {
        let interfaces = &mut self.interfaces;
        interfaces.insert(
            interface,
            Interface {
                contract,
                live: BTreeMap::new(),
                told: BTreeSet::new(),
            },
        );
    }

    /// Remembers a refusal. The one that is forgotten for it.
    //= SM2-WCH-004
    pub(super) fn refuse(
        &mut self,
        interface: InterfaceId,
        contract: Contract,
        reason: Refusal,
        limit: usize,
    ) -> Option<InterfaceId> {
        self.refused.insert(interface, (contract, reason));
        if self.refused.len() <= limit {
            return None;
        }
        let (forgotten, _) = self.refused.pop_first()?;
        Some(forgotten)
    }

    /// Forgets the refusals that an interface with this contract supersedes.
    //= SM2-WCH-004
    pub(super) fn supersede(&mut self, contract: &Contract) -> Vec<InterfaceId> {
        let alike = |it: &Contract| it.kind() == contract.kind() && it.name() == contract.name();
        let superseded = self.refused.iter().filter(|(_, (it, _))| alike(it));
        let superseded: Vec<InterfaceId> = superseded.map(|(&id, _)| id).collect();
        for id in &superseded {
            self.refused.remove(id);
        }
        superseded
    }

    /// The numbers of what was refused and is remembered.
    pub(super) fn refused(&self) -> impl ExactSizeIterator<Item = InterfaceId> {
        self.refused.keys().copied()
    }

    /// What is left of an interface, which is gone from here.
    pub(super) fn withdraw(&mut self, interface: InterfaceId) -> Option<Remains> {
        let interface = self.interfaces.remove(&interface)?;
        self.link_ends -= interface.live.len() + interface.told.len();
        Some((interface.contract, interface.live))
    }

    /// How many ends of links have not been taken leave of on both sides.
    pub(super) const fn link_ends(&self) -> usize {
        self.link_ends
    }

    /// The live ends of links, and whom each joins.
    pub(super) fn live_ends(&self) -> impl Iterator<Item = (InterfaceId, LinkId, Option<Pair>)> {
        self.interfaces.iter().flat_map(|(&id, it)| {
            let live = it.live.iter();
            live.map(move |(&link, &pair)| (id, link, pair))
        })
    }

    /// Whether a link is live, and whom it joins.
    pub(super) fn live_link(&self, interface: InterfaceId, link: LinkId) -> Option<Option<Pair>> {
        self.interfaces.get(&interface)?.live.get(&link).copied()
    }

    /// The ends of links that wait for a counterpart.
    pub(super) fn half_claims(&self) -> impl Iterator<Item = (InterfaceId, LinkId)> {
        let half = self.live_ends().filter(|(_, _, pair)| pair.is_none());
        half.map(|(interface, link, _)| (interface, link))
    }

    /// Whether the count of ends is what a recount says.
    pub(super) fn counts_its_ends(&self) -> bool {
        let told: usize = self.interfaces.values().map(|it| it.told.len()).sum();
        self.link_ends == self.live_ends().count() + told
    }

    /// Whether the interface has this link, at whatever stage; none if there is no such interface.
    pub(super) fn has_link(&self, interface: InterfaceId, link: LinkId) -> Option<bool> {
        let interface = self.interfaces.get(&interface)?;
        Some(interface.live.contains_key(&link) || interface.told.contains(&link))
    }

    /// Spends a claim: nobody can have more open links than there can be.
    //= SM2-RES-008
    pub(super) fn may_claim(&mut self) -> bool {
        let Some(resumption) = &mut self.resumption else {
            return false;
        };
        resumption.claims += 1;
        resumption.claims <= LINKS_MAX
    }

    /// The interface has claimed a link.
    pub(super) fn claim(&mut self, interface: InterfaceId, link: LinkId) {
        self.insert_link(interface, link, None);
    }

    /// The interface has a link; if it has claimed it, it is adopted now.
    pub(super) fn link(&mut self, interface: InterfaceId, link: LinkId, pair: Pair) {
        self.insert_link(interface, link, Some(pair));
    }

    fn insert_link(&mut self, interface: InterfaceId, link: LinkId, pair: Option<Pair>) {
        if let Some(interface) = self.interfaces.get_mut(&interface)
            && interface.live.insert(link, pair).is_none()
        {
            self.link_ends += 1;
        }
    }

    /// A link was never made.
    pub(super) fn unlink(&mut self, interface: InterfaceId, link: LinkId) {
        if let Some(interface) = self.interfaces.get_mut(&interface)
            && interface.live.remove(&link).is_some()
        {
            self.link_ends -= 1;
        }
    }

    /// A link has ended before all is claimed, or settled.
    //= SM2-RES-007
    pub(super) fn ended(&mut self, pair: Pair) {
        let resumption = self.resumption.as_mut().map(|it| &mut it.ended);
        let settling = self.settling.as_mut().map(|it| &mut it.ended);
        if let Some(ended) = resumption.or(settling) {
            ended.insert(pair);
        }
    }

    /// UNLINK is sent for a live link.
    pub(super) fn tell(&mut self, interface: InterfaceId, link: LinkId) {
        if let Some(interface) = self.interfaces.get_mut(&interface)
            && interface.live.remove(&link).is_some()
        {
            interface.told.insert(link);
        }
    }

    /// UNLINKED has come: the end is never named again.
    //= SM2-LNK-003
    pub(super) fn farewell(
        &mut self,
        interface: InterfaceId,
        link: LinkId,
    ) -> Result<Farewells, Violation> {
        let interface = self.interfaces.get_mut(&interface);
        let interface = interface.ok_or(violation!(UnknownInterface, "SM2-LNK-003"))?;
        let farewells = if let Some(pair) = interface.live.remove(&link) {
            Farewells::First(pair)
        } else if interface.told.remove(&link) {
            Farewells::Both
        } else {
            return Err(violation!(UnknownLink, "SM2-LNK-003"));
        };
        self.link_ends -= 1;
        Ok(farewells)
    }

    /// The session registers the text of a type. Whether it is to be kept: it is new
    /// here, and within the quota.
    //= SM2-SCH-001
    pub(super) fn register(&mut self, data: &TypeId, cost_bytes: usize, quota: usize) -> bool {
        let bytes = self.schema_bytes + cost_bytes;
        if bytes > quota || !self.schemas.insert(data.clone()) {
            return false;
        }
        self.schema_bytes = bytes;
        true
    }

    /// The types whose texts it registered.
    pub(super) fn schemas(&self) -> impl Iterator<Item = &TypeId> {
        self.schemas.iter()
    }
}

fn interface(entity: EntityId, contract: &Contract) -> Item {
    Item::Interface {
        entity,
        contract: contract.clone(),
    }
}

fn refusal(entity: EntityId, (contract, reason): &(Contract, Refusal)) -> Item {
    Item::Refusal {
        entity,
        contract: contract.clone(),
        reason: reason.clone(),
    }
}
