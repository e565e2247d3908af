//! One connection: whose it is, how far it has come, what it declared.

use alloc::{
    collections::{BTreeMap, BTreeSet},
    vec::Vec,
};

use super::{Credentials, Policy, phase::Phase, policy::exceeded};
use crate::{Contract, InterfaceId, Name, Quota, Refusal, Violation};

#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub(super) struct Session {
    credentials: Credentials,
    /// Known once the session is ready.
    name: Option<Name>,
    last_interface: u64,
    interfaces: BTreeMap<InterfaceId, Interface>,
    /// How many ends of links all interfaces have together.
    link_ends: usize,
}

#[derive(Clone, Debug, PartialEq, Eq, Hash)]
struct Interface {
    contract: Contract,
    /// The links of which this end has not been taken leave of on both sides.
    links: BTreeSet<u64>,
}

impl Session {
    pub(super) const fn new(credentials: Credentials) -> Self {
        Self {
            credentials,
            name: None,
            last_interface: 0,
            interfaces: BTreeMap::new(),
            link_ends: 0,
        }
    }

    pub(super) const fn credentials(&self) -> Credentials {
        self.credentials
    }

    pub(super) const fn phase(&self) -> Phase {
        if self.is_ready() {
            Phase::Ready
        } else {
            Phase::Greeting
        }
    }

    pub(super) const fn is_ready(&self) -> bool {
        self.name.is_some()
    }

    pub(super) const fn name(&self) -> Option<&Name> {
        self.name.as_ref()
    }

    pub(super) fn welcome(&mut self, name: Name) {
        self.name = Some(name);
    }

    /// Spends an interface number.
    //= SM2-IFC-001
    pub(super) fn number(&mut self, interface: InterfaceId) -> Result<(), Violation> {
        if interface.0 <= self.last_interface {
            return Err(Violation::InterfaceNumber);
        }
        self.last_interface = interface.0;
        Ok(())
    }

    pub(super) fn refuse_interface(&self, policy: &Policy) -> Result<(), Refusal> {
        let limit = policy.interfaces_per_session;
        exceeded(self.interfaces.len(), limit, Quota::InterfacesPerSession)
    }

    pub(super) fn declare(&mut self, interface: InterfaceId, contract: Contract) {
        self.interfaces.insert(
            interface,
            Interface {
                contract,
                links: BTreeSet::new(),
            },
        );
    }

    /// The interface's contract and links, which are not this session's any more.
    pub(super) fn withdraw(&mut self, interface: InterfaceId) -> Option<(Contract, BTreeSet<u64>)> {
        let Interface { contract, links } = self.interfaces.remove(&interface)?;
        self.link_ends -= links.len();
        Some((contract, links))
    }

    pub(super) fn into_interfaces(self) -> Vec<(InterfaceId, Contract, BTreeSet<u64>)> {
        let each = |(id, Interface { contract, links })| (id, contract, links);
        self.interfaces.into_iter().map(each).collect()
    }

    pub(super) fn interfaces(&self) -> usize {
        self.interfaces.len()
    }

    pub(super) fn contract(&self, interface: InterfaceId) -> Option<&Contract> {
        self.interfaces
            .get(&interface)
            .map(|interface| &interface.contract)
    }

    /// The interfaces after a position, with their links.
    pub(super) fn after(
        &self,
        after: InterfaceId,
    ) -> impl Iterator<Item = (InterfaceId, &Contract, &BTreeSet<u64>)> {
        let from = (
            core::ops::Bound::Excluded(after),
            core::ops::Bound::Unbounded,
        );
        self.interfaces
            .range(from)
            .map(|(&id, it)| (id, &it.contract, &it.links))
    }

    pub(super) const fn link_ends(&self) -> usize {
        self.link_ends
    }

    pub(super) fn link(&mut self, interface: InterfaceId, serial: u64) {
        let Some(interface) = self.interfaces.get_mut(&interface) else {
            return;
        };
        if interface.links.insert(serial) {
            self.link_ends += 1;
        }
    }

    /// Whether the interface has an end of this link.
    pub(super) fn knows_link(
        &self,
        interface: InterfaceId,
        serial: u64,
    ) -> Result<bool, Violation> {
        let interface = self
            .interfaces
            .get(&interface)
            .ok_or(Violation::UnknownInterface)?;
        Ok(interface.links.contains(&serial))
    }

    pub(super) fn forget_link(&mut self, interface: InterfaceId, serial: u64) {
        let Some(interface) = self.interfaces.get_mut(&interface) else {
            return;
        };
        if interface.links.remove(&serial) {
            self.link_ends -= 1;
        }
    }
}
