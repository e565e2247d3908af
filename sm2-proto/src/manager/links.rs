//! The links that are live at both ends, with their pairs and their QoS.

#[cfg(any(kani, test))]
mod proofs;

use alloc::collections::{BTreeMap, BTreeSet};
use core::{fmt, hash::Hasher, ops::Bound};

use siphasher::sip::SipHasher24;

use crate::{Contract, EntityId, Kind, LinkId, LinkKey, LinkQos, NodeId, control::Item};

/// A publisher or server, and a subscriber or client.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub(super) struct Pair {
    pub(super) offering: EntityId,
    pub(super) demanding: EntityId,
}

impl Pair {
    /// The pair of an interface with this contract and a counterpart.
    pub(super) const fn new(one: EntityId, contract: &Contract, other: EntityId) -> Self {
        let (offering, demanding) = match contract.kind() {
            Kind::Publisher | Kind::Server => (one, other),
            Kind::Subscriber | Kind::Client => (other, one),
        };
        Self {
            offering,
            demanding,
        }
    }

    pub(super) const fn entities(self) -> [EntityId; 2] {
        [self.offering, self.demanding]
    }

    /// The sessions of both ends, each once.
    pub(super) fn nodes(self) -> impl Iterator<Item = NodeId> {
        let [one, other] = self.entities().map(|it| it.node);
        core::iter::once(one).chain((other != one).then_some(other))
    }

    /// The number of ends at a session.
    pub(super) fn ends_at(self, node: NodeId) -> usize {
        self.entities().iter().filter(|it| it.node == node).count()
    }

    pub(super) fn other(self, one: EntityId) -> EntityId {
        if one == self.offering {
            self.demanding
        } else {
            self.offering
        }
    }
}

/// The version and the QoS of a link, which stay as long as it lives.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub(super) struct Agreed {
    pub(super) version: u16,
    pub(super) qos: LinkQos,
}

/// A link leaves this table with its first farewell. Each [`Session`](super::session::Session)
/// knows which farewells are still to come.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub(super) struct Links {
    epoch: u64,
    secret: Secret,
    last_serial: u64,
    /// By number and offering side: adopted links may share a number (SM2-RES-004).
    live: BTreeMap<(LinkId, EntityId), (EntityId, Agreed)>,
    /// The same links, by their pairs.
    pairs: BTreeSet<Pair>,
}

impl Links {
    pub(super) const fn new(epoch: u64, secret: u128) -> Self {
        Self {
            epoch,
            secret: Secret(secret),
            last_serial: 0,
            live: BTreeMap::new(),
            pairs: BTreeSet::new(),
        }
    }

    pub(super) const fn epoch(&self) -> u64 {
        self.epoch
    }

    /// The number and the key of a new link.
    //= SM2-LNK-002
    pub(super) fn number(&mut self) -> (LinkId, LinkKey) {
        self.last_serial += 1;
        let serial = self.last_serial;
        let epoch = self.epoch;
        let link = LinkId { epoch, serial };
        (link, self.key(link))
    }

    /// The key of a link of this Manager.
    pub(super) fn key(&self, link: LinkId) -> LinkKey {
        self.secret.key(link.serial)
    }

    /// The pair, the version and the QoS of a live link that this Manager made.
    pub(super) fn made_as(&self, link: LinkId) -> Option<(Pair, Agreed)> {
        let pair = self.made(link)?;
        let &(_, agreed) = self.live.get(&(link, pair.offering))?;
        Some((pair, agreed))
    }

    /// Adds a live link. No two live links join the same pair.
    pub(super) fn insert(&mut self, link: LinkId, pair: Pair, agreed: Agreed) {
        self.live
            .insert((link, pair.offering), (pair.demanding, agreed));
        self.pairs.insert(pair);
    }

    /// Removes a link. Returns whether it was live.
    pub(super) fn remove(&mut self, link: LinkId, pair: Pair) -> bool {
        self.live.remove(&(link, pair.offering)).is_some() && self.pairs.remove(&pair)
    }

    /// The pair of a live link that this Manager made.
    pub(super) fn made(&self, link: LinkId) -> Option<Pair> {
        let mut rest = self.live.range((link, EntityId::FIRST)..);
        let (&(found, offering), &(demanding, _)) = rest.next()?;
        (found == link && link.epoch == self.epoch).then_some(Pair {
            offering,
            demanding,
        })
    }

    pub(super) fn joins(&self, pair: Pair) -> bool {
        self.pairs.contains(&pair)
    }

    pub(super) fn item(&self, link: LinkId, offering: EntityId) -> Option<Item> {
        let found = self.live.get(&(link, offering))?;
        Some(item(link, offering, *found))
    }

    /// In the order of their keys.
    pub(super) fn items(&self, after: (LinkId, EntityId)) -> impl Iterator<Item = Item> {
        let rest = (Bound::Excluded(after), Bound::Unbounded);
        let rest = self.live.range(rest);
        rest.map(|(&(link, offering), &rest)| item(link, offering, rest))
    }

    /// Every link and its pair.
    pub(super) fn iter(&self) -> impl Iterator<Item = (LinkId, Pair)> {
        self.live
            .iter()
            .map(|(&(link, offering), &(demanding, _))| {
                (
                    link,
                    Pair {
                        offering,
                        demanding,
                    },
                )
            })
    }

    pub(super) fn len(&self) -> usize {
        self.live.len()
    }

    /// Whether the two tables agree.
    pub(super) fn agree(&self) -> bool {
        self.pairs.len() == self.live.len() && self.iter().all(|(_, pair)| self.joins(pair))
    }
}

fn item(link: LinkId, offering: EntityId, (demanding, agreed): (EntityId, Agreed)) -> Item {
    Item::Link {
        link,
        offering,
        demanding,
        version: agreed.version,
        reliable: agreed.qos.reliable,
        sealed: agreed.qos.sealed,
    }
}

/// The secret that determines the keys of this Manager's links.
#[derive(Clone, PartialEq, Eq, Hash)]
struct Secret(u128);

impl Secret {
    fn key(&self, serial: u64) -> LinkKey {
        let mut hasher = SipHasher24::new_with_key(&self.0.to_le_bytes());
        hasher.write(&serial.to_le_bytes());
        LinkKey(hasher.finish())
    }
}

/// Logs must not show the secret: a process that knows it can claim every link.
impl fmt::Debug for Secret {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("Secret")
    }
}
