//! The unit for weighing topics and services.

use std::collections::BTreeMap;

/// The descriptors of a subscription or client for tokio, apart from its links: three sets of sockets, and a waker.
const PER_SUBSCRIPTION: u64 = 4;
/// The descriptors that a link may need, as `sm2-node` counts them.
const PER_LINK: u64 = 2;

/// A process of the domain, as the kernel names it.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Process {
    /// Its user.
    pub uid: u32,
    /// Its number. Processes of a user whose numbers the kernel does not tell count as one.
    pub pid: i32,
}

/// The number of publishers of a topic, or of servers of a service, that each process has.
pub type Links = BTreeMap<Process, u64>;

/// Room for topics and services of the domain.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Room {
    /// Descriptors of subscriptions, clients and their links.
    pub descriptors: u64,
    /// Subscriptions and clients.
    pub interfaces: u64,
}

impl Room {
    /// More than any gateway needs.
    pub const UNLIMITED: Self = Self {
        descriptors: u64::MAX,
        interfaces: u64::MAX,
    };
    pub(super) const NONE: Self = Self {
        descriptors: 0,
        interfaces: 0,
    };

    pub(super) const fn and(self, more: Self) -> Self {
        Self {
            descriptors: self.descriptors.saturating_add(more.descriptors),
            interfaces: self.interfaces.saturating_add(more.interfaces),
        }
    }

    pub(super) const fn without(self, less: Self) -> Self {
        Self {
            descriptors: self.descriptors.saturating_sub(less.descriptors),
            interfaces: self.interfaces.saturating_sub(less.interfaces),
        }
    }

    pub(super) const fn fits(self, room: Self) -> bool {
        self.descriptors <= room.descriptors && self.interfaces <= room.interfaces
    }
}

/// The room that a topic or service with these links needs.
pub(super) fn need(links: &Links) -> Room {
    let links: u64 = links.values().sum();
    Room {
        descriptors: PER_SUBSCRIPTION + PER_LINK * links,
        interfaces: 1,
    }
}
