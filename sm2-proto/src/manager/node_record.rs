//! The Manager's record of a welcomed node: its interfaces, their ends of links, and its other
//! registrations.

#[cfg(any(kani, test))]
mod proofs;

use alloc::{
    collections::{BTreeMap, BTreeSet},
    sync::Arc,
    vec::Vec,
};
use core::ops::Bound;

use super::{Credentials, links::Pair, quota::within};
use crate::{
    Contract, EntityId, InterfaceId, LinkId, Name, Quota, Refusal, TypeId, Violation,
    control::{Item, Limit, Limits},
};

#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub(super) struct NodeRecord {
    credentials: Credentials,
    name: Name,
    last_interface: InterfaceId,
    interfaces: BTreeMap<InterfaceId, InterfaceRecord>,
    /// The latest refused interfaces, and the reasons.
    refused: BTreeMap<InterfaceId, (Contract, Refusal)>,
    /// The number of LINKs that were sent since the node's socket had last taken all that was sent
    /// to it.
    pub(super) links_in_flight: usize,
    /// The number of link ends of all interfaces together.
    link_ends: usize,
    /// The number of these ends that the node knows: LINK named them, or the node claimed them.
    known_ends: usize,
    /// The number of ends of links that the node can have at a time, if it stated one.
    max_links: Option<u32>,
    /// The types whose texts the node registered.
    schemas: BTreeSet<TypeId>,
    schema_bytes: usize,
}

#[derive(Clone, Debug, PartialEq, Eq, Hash)]
struct InterfaceRecord {
    /// Shared with the channel.
    contract: Arc<Contract>,
    /// Why the access policy denies the interface, which then is on no channel.
    suspended: Option<Refusal>,
    /// The links without a farewell of either side, and their pairs. A link has no pair as
    /// long as the other end has not claimed it.
    live: BTreeMap<LinkId, Option<Pair>>,
    /// The links whose UNLINK was sent and whose UNLINKED has not come. With their pairs, if UNLINKED
    /// can still be the reason to link the pair again.
    unlinking: BTreeMap<LinkId, Option<Pair>>,
    /// The number of these links that the node knows.
    known: usize,
}

/// The remains of an interface: its contract and its live links.
pub(super) type Remains = (Arc<Contract>, BTreeMap<LinkId, Option<Pair>>);

/// Which farewells of a link's end were said before the node's own (SM2-LNK-003).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Farewells {
    /// None: the node is first and has to be answered. The link joined this pair.
    First(Option<Pair>),
    /// The Manager's UNLINK: now both are said. The pair is there if this UNLINKED can be the reason
    /// to link it again.
    Second(Option<Pair>),
}

impl NodeRecord {
    pub(super) const fn new(credentials: Credentials, name: Name) -> Self {
        Self {
            credentials,
            name,
            last_interface: InterfaceId(0),
            interfaces: BTreeMap::new(),
            refused: BTreeMap::new(),
            links_in_flight: 0,
            link_ends: 0,
            known_ends: 0,
            max_links: None,
            schemas: BTreeSet::new(),
            schema_bytes: 0,
        }
    }

    pub(super) const fn credentials(&self) -> Credentials {
        self.credentials
    }

    pub(super) const fn name(&self) -> &Name {
        &self.name
    }

    /// The greatest number of an interface or refusal.
    pub(super) const fn last_interface(&self) -> InterfaceId {
        self.last_interface
    }

    /// The first interface from this number on.
    pub(super) fn interface_from(&self, first: InterfaceId) -> Option<InterfaceId> {
        let (&interface, _) = self.interfaces.range(first..).next()?;
        Some(interface)
    }

    /// Spends an interface number.
    //= SM2-IFC-001
    pub(super) fn number(&mut self, interface: InterfaceId) -> Result<(), Violation> {
        if interface <= self.last_interface {
            return Err(violation!(BadInterfaceId, "SM2-IFC-001"));
        }
        self.last_interface = interface;
        Ok(())
    }

    pub(super) fn refuse_interface(&self, limits: &Limits) -> Result<(), Refusal> {
        let limit = limits.count(Limit::InterfacesPerSession);
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

    /// Why the access policy denies an interface, if it does.
    pub(super) fn suspended(&self, interface: InterfaceId) -> Option<&Refusal> {
        self.interfaces.get(&interface)?.suspended.as_ref()
    }

    /// The policy denies the interface, or allows it again (`None`).
    pub(super) fn set_suspended(&mut self, interface: InterfaceId, reason: Option<Refusal>) {
        if let Some(interface) = self.interfaces.get_mut(&interface) {
            interface.suspended = reason;
        }
    }

    /// The number of interfaces that are not suspended, by a recount.
    pub(super) fn granted(&self) -> usize {
        let interfaces = self.interfaces.values();
        interfaces.filter(|it| it.suspended.is_none()).count()
    }

    /// The oldest live link of an interface, and its pair.
    pub(super) fn first_live(&self, interface: InterfaceId) -> Option<(LinkId, Option<Pair>)> {
        let (&link, &pair) = self.interfaces.get(&interface)?.live.first_key_value()?;
        Some((link, pair))
    }

    /// An interface or refusal as an item.
    pub(super) fn member(&self, entity: EntityId) -> Option<Item> {
        if let Some(found) = self.interfaces.get(&entity.interface) {
            return Some(interface(entity, found));
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
                Some(interface(at(id), it))
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
            InterfaceRecord {
                contract,
                suspended: None,
                live: BTreeMap::new(),
                unlinking: BTreeMap::new(),
                known: 0,
            },
        );
    }

    /// Remembers a refusal. Returns the one that is forgotten in its place.
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

    /// The numbers of the refusals that are remembered.
    pub(super) fn refused(&self) -> impl ExactSizeIterator<Item = InterfaceId> {
        self.refused.keys().copied()
    }

    /// Removes an interface and returns its remains.
    pub(super) fn withdraw(&mut self, interface: InterfaceId) -> Option<Remains> {
        let interface = self.interfaces.remove(&interface)?;
        self.link_ends -= interface.live.len() + interface.unlinking.len();
        self.known_ends -= interface.known;
        Some((interface.contract, interface.live))
    }

    /// The number of link ends without both farewells.
    pub(super) const fn link_ends(&self) -> usize {
        self.link_ends
    }

    pub(super) const fn max_links(&self) -> Option<u32> {
        self.max_links
    }

    /// MAX_LINKS has come. Returns whether it states another number than before.
    //= SM2-LNK-007
    pub(super) fn set_max_links(&mut self, max_links: u32) -> bool {
        self.max_links.replace(max_links) != Some(max_links)
    }

    /// Whether the node has no room for this many ends of links beside those that it knows.
    //= SM2-LNK-007
    pub(super) fn lacks_room_for(&self, ends: usize) -> bool {
        let room = |max_links| usize::try_from(max_links).unwrap_or(usize::MAX);
        (self.max_links).is_some_and(|max_links| self.known_ends + ends > room(max_links))
    }

    /// The LINK of a link of this interface is sent.
    //= SM2-LNK-006, SM2-LNK-007
    pub(super) fn announce(&mut self, interface: InterfaceId) {
        self.links_in_flight += 1;
        self.know(interface);
    }

    /// The LINK of a link of this interface was not sent after all. The interface may be gone.
    pub(super) fn not_announced(&mut self, interface: InterfaceId) {
        self.links_in_flight = self.links_in_flight.saturating_sub(1);
        if let Some(interface) = self.interfaces.get_mut(&interface) {
            interface.known -= 1;
            self.known_ends -= 1;
        }
    }

    fn know(&mut self, interface: InterfaceId) {
        if let Some(interface) = self.interfaces.get_mut(&interface) {
            interface.known += 1;
            self.known_ends += 1;
        }
    }

    /// The ends of links that the node knows, of each interface: the links of all interfaces, less
    /// those that `is_pending` names. For a recount.
    pub(super) fn counts_known_ends(&self, is_pending: impl Fn(LinkId) -> bool) -> bool {
        let known = |it: &InterfaceRecord| {
            let live = it.live.keys().filter(|&&link| !is_pending(link)).count();
            live + it.unlinking.len()
        };
        let interfaces = || self.interfaces.values();
        interfaces().all(|it| it.known == known(it))
            && interfaces().map(|it| it.known).sum::<usize>() == self.known_ends
    }

    /// The live ends of links, and their pairs.
    pub(super) fn live_ends(&self) -> impl Iterator<Item = (InterfaceId, LinkId, Option<Pair>)> {
        self.interfaces.iter().flat_map(|(&id, it)| {
            let live = it.live.iter();
            live.map(move |(&link, &pair)| (id, link, pair))
        })
    }

    /// The pair of a live link, which the link lacks until its other end has claimed it. The outer
    /// `None`: the link is not live.
    pub(super) fn live_link(&self, interface: InterfaceId, link: LinkId) -> Option<Option<Pair>> {
        self.interfaces.get(&interface)?.live.get(&link).copied()
    }

    /// The ends of links that wait for a counterpart.
    pub(super) fn half_claims(&self) -> impl Iterator<Item = (InterfaceId, LinkId)> {
        let half = self.live_ends().filter(|(_, _, pair)| pair.is_none());
        half.map(|(interface, link, _)| (interface, link))
    }

    /// Whether the count of link ends equals a recount.
    pub(super) fn counts_its_ends(&self) -> bool {
        let unlinking: usize = self.interfaces.values().map(|it| it.unlinking.len()).sum();
        self.link_ends == self.live_ends().count() + unlinking
    }

    /// Whether the interface has this link, at any stage; `None` without such an interface.
    pub(super) fn has_link(&self, interface: InterfaceId, link: LinkId) -> Option<bool> {
        let interface = self.interfaces.get(&interface)?;
        Some(interface.live.contains_key(&link) || interface.unlinking.contains_key(&link))
    }

    /// The interface has claimed a link.
    pub(super) fn claim(&mut self, interface: InterfaceId, link: LinkId) {
        self.insert_link(interface, link, None);
        self.know(interface);
    }

    /// The interface has a link. A claimed link is adopted by this call.
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

    /// Removes a link that was never made.
    pub(super) fn remove_link(&mut self, interface: InterfaceId, link: LinkId) {
        if let Some(interface) = self.interfaces.get_mut(&interface)
            && interface.live.remove(&link).is_some()
        {
            self.link_ends -= 1;
        }
    }

    /// Notes that UNLINK is sent for a live link. Returns whether the interface has the link. `pair`
    /// is that of the link if UNLINKED can still be the reason to link the pair again.
    //= SM2-LNK-009
    pub(super) fn begin_unlink(
        &mut self,
        interface: InterfaceId,
        link: LinkId,
        pair: Option<Pair>,
    ) -> bool {
        let Some(interface) = self.interfaces.get_mut(&interface) else {
            return false;
        };
        interface.live.remove(&link).is_some() && interface.unlinking.insert(link, pair).is_none()
    }

    /// Notes that UNLINKED has come: this end is never named again.
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
        } else if let Some(pair) = interface.unlinking.remove(&link) {
            Farewells::Second(pair)
        } else {
            return Err(violation!(UnknownLink, "SM2-LNK-003"));
        };
        interface.known -= 1;
        self.known_ends -= 1;
        self.link_ends -= 1;
        Ok(farewells)
    }

    /// Registers the text of a type. Returns whether the text is to be kept: it is new here and
    /// within the quota.
    //= SM2-SCH-001
    pub(super) fn register(&mut self, data: &TypeId, cost_bytes: usize, quota: usize) -> bool {
        let bytes = self.schema_bytes + cost_bytes;
        if bytes > quota || !self.schemas.insert(data.clone()) {
            return false;
        }
        self.schema_bytes = bytes;
        true
    }

    /// The types whose texts the node registered.
    pub(super) fn schemas(&self) -> impl Iterator<Item = &TypeId> {
        self.schemas.iter()
    }
}

/// An interface; one that the access policy denies is shown as a refusal.
//= SM2-ACC-013
fn interface(entity: EntityId, interface: &InterfaceRecord) -> Item {
    let contract = Contract::clone(&interface.contract);
    match interface.suspended.clone() {
        None => Item::Interface { entity, contract },
        Some(reason) => Item::Refusal {
            entity,
            contract,
            reason,
        },
    }
}

fn refusal(entity: EntityId, (contract, reason): &(Contract, Refusal)) -> Item {
    Item::Refusal {
        entity,
        contract: contract.clone(),
        reason: reason.clone(),
    }
}
