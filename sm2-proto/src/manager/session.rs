//! One connection: whose it is, how far it has come, what it declared.

use alloc::{
    collections::{BTreeMap, BTreeSet},
    sync::Arc,
    vec::Vec,
};
use core::ops::Bound;

use super::{Credentials, Policy, phase::Phase, policy::within};
use crate::{Contract, InterfaceId, LinkId, Name, Quota, Refusal, Violation};

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
    /// Shared with its channel.
    contract: Arc<Contract>,
    /// The links of which nobody has taken leave.
    live: BTreeSet<LinkId>,
    /// Those for which UNLINK was sent and UNLINKED has not come.
    told: BTreeSet<LinkId>,
}

/// How far the farewells of a link's end have come when the node says its own
/// (SM2-LNK-003).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Farewells {
    /// The node is first and has to be answered.
    First,
    /// UNLINK was sent before: both are said.
    Both,
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
        within(limit, self.interfaces() + 1, Quota::InterfacesPerSession)
    }

    pub(super) fn interfaces(&self) -> usize {
        self.interfaces.len()
    }

    pub(super) fn contract(&self, interface: InterfaceId) -> Option<&Contract> {
        let interface = self.interfaces.get(&interface)?;
        Some(&interface.contract)
    }

    /// The interfaces after a position, each with its number of live links.
    pub(super) fn after(
        &self,
        after: InterfaceId,
    ) -> impl Iterator<Item = (InterfaceId, &Contract, usize)> {
        let rest = (Bound::Excluded(after), Bound::Unbounded);
        let rest = self.interfaces.range(rest);
        rest.map(|(&id, it)| (id, &*it.contract, it.live.len()))
    }

    pub(super) fn declare(&mut self, interface: InterfaceId, contract: Arc<Contract>) {
        let interfaces = &mut self.interfaces;
        interfaces.insert(
            interface,
            Interface {
                contract,
                live: BTreeSet::new(),
                told: BTreeSet::new(),
            },
        );
    }

    /// The interface's contract and live links, which are gone from here.
    pub(super) fn withdraw(
        &mut self,
        interface: InterfaceId,
    ) -> Option<(Arc<Contract>, BTreeSet<LinkId>)> {
        let interface = self.interfaces.remove(&interface)?;
        self.link_ends -= interface.live.len() + interface.told.len();
        Some((interface.contract, interface.live))
    }

    /// All interfaces with their contracts and live links.
    pub(super) fn into_interfaces(self) -> Vec<(InterfaceId, Arc<Contract>, BTreeSet<LinkId>)> {
        let each = |(id, it): (InterfaceId, Interface)| (id, it.contract, it.live);
        self.interfaces.into_iter().map(each).collect()
    }

    /// How many ends of links have not been taken leave of on both sides.
    pub(super) const fn link_ends(&self) -> usize {
        self.link_ends
    }

    /// How many of them are live.
    pub(super) fn live_ends(&self) -> usize {
        self.interfaces.values().map(|it| it.live.len()).sum()
    }

    /// Whether the count of ends is what a recount says.
    pub(super) fn counts_its_ends(&self) -> bool {
        let told: usize = self.interfaces.values().map(|it| it.told.len()).sum();
        self.link_ends == self.live_ends() + told
    }

    pub(super) fn link(&mut self, interface: InterfaceId, link: LinkId) {
        if let Some(interface) = self.interfaces.get_mut(&interface)
            && interface.live.insert(link)
        {
            self.link_ends += 1;
        }
    }

    /// A link was never made.
    pub(super) fn unlink(&mut self, interface: InterfaceId, link: LinkId) {
        if let Some(interface) = self.interfaces.get_mut(&interface)
            && interface.live.remove(&link)
        {
            self.link_ends -= 1;
        }
    }

    /// UNLINK is sent for a live link.
    pub(super) fn tell(&mut self, interface: InterfaceId, link: LinkId) {
        if let Some(interface) = self.interfaces.get_mut(&interface)
            && interface.live.remove(&link)
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
        let interface = interface.ok_or(Violation::UnknownInterface)?;
        let farewells = if interface.live.remove(&link) {
            Farewells::First
        } else if interface.told.remove(&link) {
            Farewells::Both
        } else {
            return Err(Violation::UnknownLink);
        };
        self.link_ends -= 1;
        Ok(farewells)
    }
}
