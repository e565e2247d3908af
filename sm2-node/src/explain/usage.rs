//! The used part of each quota.

use std::collections::BTreeMap;

use sm2_proto::{NodeId, control::Item, domain::Domain};

/// The usage of a user.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub struct UserUsage {
    /// Sessions, of `sessions_per_user`.
    pub sessions: u32,
    /// Interfaces of all these sessions, of `interfaces_per_user`.
    pub interfaces: u32,
}

/// The usage of a process of a user.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub struct ProcessUsage {
    /// Sessions, of `sessions_per_process`.
    pub sessions: u32,
    /// Interfaces of all these sessions, of `interfaces_per_process`.
    pub interfaces: u32,
}

/// The usage of a session.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub struct SessionUsage {
    /// Interfaces, of `interfaces_per_session`.
    pub interfaces: u32,
    /// Ends of links, of waiting links and claims, of `links_per_session`.
    pub links: u32,
    /// Refused interfaces, of `refusals_per_session`.
    pub refusals: u32,
    /// Unlinked pairs whose publisher or server belongs to the session, of `unlinked_per_session`.
    pub unlinked: u32,
}

/// The usage of each user.
#[must_use]
pub fn users(domain: &Domain) -> BTreeMap<u32, UserUsage> {
    let mut users: BTreeMap<_, UserUsage> = BTreeMap::new();
    let interfaces = sessions(domain);
    for node in domain.nodes() {
        let usage = users.entry(node.uid).or_default();
        usage.sessions += 1;
        usage.interfaces += interfaces.get(&node.node).map_or(0, |it| it.interfaces);
    }
    users
}

/// The usage of each process that has a share of its own, by user and process.
#[must_use]
pub fn processes(domain: &Domain) -> BTreeMap<(u32, i32), ProcessUsage> {
    let mut processes: BTreeMap<_, ProcessUsage> = BTreeMap::new();
    let interfaces = sessions(domain);
    for node in domain.nodes().filter(|it| it.pid > 0) {
        let usage = processes.entry((node.uid, node.pid)).or_default();
        usage.sessions += 1;
        usage.interfaces += interfaces.get(&node.node).map_or(0, |it| it.interfaces);
    }
    processes
}

/// The usage of each session.
#[must_use]
pub fn sessions(domain: &Domain) -> BTreeMap<NodeId, SessionUsage> {
    let mut sessions: BTreeMap<_, SessionUsage> = domain
        .nodes()
        .map(|node| (node.node, SessionUsage::default()))
        .collect();
    let mut count = |node: &NodeId, counted: fn(&mut SessionUsage) -> &mut u32| {
        if let Some(usage) = sessions.get_mut(node) {
            *counted(usage) += 1;
        }
    };
    for interface in domain.interfaces() {
        count(
            &interface.entity.node,
            match interface.refused {
                None => |it| &mut it.interfaces,
                Some(_) => |it| &mut it.refusals,
            },
        );
    }
    for item in domain.items() {
        if let Item::Unlinked { offering, .. } = item {
            count(&offering.node, |it| &mut it.unlinked);
        }
    }
    for link in domain.links() {
        count(&link.offering.node, |it| &mut it.links);
        count(&link.demanding.node, |it| &mut it.links);
    }
    for (_, offering, demanding) in domain.waiting_links() {
        count(&offering.node, |it| &mut it.links);
        count(&demanding.node, |it| &mut it.links);
    }
    for (_, entity) in domain.claims() {
        count(&entity.node, |it| &mut it.links);
    }
    sessions
}
