//! An oracle of SPEC section 11: plain lists, without regard for speed.

use std::collections::{BTreeMap, BTreeSet};

use sm2_proto::{
    Contract, EntityId, LinkId, LinkKey, NodeId,
    control::{Item, Limits},
    match_contracts,
};

use crate::support::bench::EPOCH;

/// The fields of a claim.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) struct Said {
    pub(crate) serial: u64,
    pub(crate) key: LinkKey,
    pub(crate) reliable: bool,
    pub(crate) sealed: bool,
}

#[derive(Clone, Debug)]
pub(crate) struct ConnectedNode {
    pub(crate) node: NodeId,
    pub(crate) uid: u32,
    pub(crate) resuming: bool,
    pub(crate) last: u64,
    pub(crate) greet_until: u64,
}

/// One link: its number, its QoS and its two ends, the offering side first.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Link {
    pub(crate) id: LinkId,
    pub(crate) ends: [EntityId; 2],
    pub(crate) reliable: bool,
    pub(crate) sealed: bool,
}

#[derive(Clone, Debug)]
pub(crate) struct Half {
    pub(crate) id: LinkId,
    pub(crate) entity: EntityId,
    pub(crate) said: Said,
    pub(crate) until: Option<u64>,
}

/// A frame to a session: to end a link, or about a new one.
pub(crate) type Told = (EntityId, LinkId, Option<u16>);

#[derive(Clone, Debug, Default)]
pub(crate) struct Oracle {
    pub(crate) sessions: BTreeMap<NodeId, ConnectedNode>,
    pub(crate) interfaces: BTreeMap<EntityId, Contract>,
    pub(crate) links: Vec<Link>,
    pub(crate) halves: Vec<Half>,
    /// Ends whose UNLINK was sent and whose UNLINKED has not come.
    pub(crate) told: BTreeSet<(EntityId, LinkId)>,
    /// Pairs that ended a link.
    ended: BTreeSet<[EntityId; 2]>,
    pub(crate) made: u64,
    pub(crate) events: Vec<Told>,
    pub(crate) now: u64,
}

impl Oracle {
    pub(crate) fn tell(&mut self, entity: EntityId, id: LinkId, code: u16) {
        if self.interfaces.contains_key(&entity) {
            self.told.insert((entity, id));
            self.events.push((entity, id, Some(code)));
        }
    }

    /// The QoS that SPEC demands of a link; `None` if the two do not match.
    pub(crate) fn qos(
        &self,
        limits: &Limits,
        one: EntityId,
        other: EntityId,
    ) -> Option<(bool, bool)> {
        let qos = match_contracts(&self.interfaces[&one], &self.interfaces[&other]).ok()?;
        let same = self.sessions[&one.node].uid == self.sessions[&other.node].uid;
        Some((qos.reliable, qos.sealed || limits.seal_all || !same))
    }

    pub(crate) fn pair(&self, one: EntityId, other: EntityId) -> [EntityId; 2] {
        let offers = matches!(self.interfaces[&one], Contract::Publisher { .. });
        if offers { [one, other] } else { [other, one] }
    }

    /// Links one interface with all others that it can be linked with, because its session is
    /// ready.
    pub(crate) fn link_all(&mut self, limits: &Limits, one: EntityId) -> usize {
        let before = self.links.len();
        let others: Vec<EntityId> = self.interfaces.keys().copied().collect();
        for other in others {
            let Some((reliable, sealed)) = self.qos(limits, one, other) else {
                continue;
            };
            let ends = self.pair(one, other);
            let ready = !self.sessions[&other.node].resuming;
            let linked = self.links.iter().any(|link| link.ends == ends);
            if ready && !linked && !self.ended.contains(&ends) {
                self.made += 1;
                let id = LinkId {
                    epoch: EPOCH,
                    serial: self.made,
                };
                self.links.push(Link {
                    id,
                    ends,
                    reliable,
                    sealed,
                });
                self.events.extend(ends.map(|end| (end, id, None)));
            }
        }
        self.links.len() - before
    }

    pub(crate) fn has(&self, entity: EntityId, id: LinkId) -> bool {
        self.told.contains(&(entity, id))
            || self
                .halves
                .iter()
                .any(|it| it.entity == entity && it.id == id)
            || self
                .links
                .iter()
                .any(|it| it.id == id && it.ends.contains(&entity))
    }

    pub(crate) fn claim(&mut self, limits: &Limits, entity: EntityId, id: LinkId, said: Said) {
        let meets = |it: &Half| it.id == id && it.said == said;
        let Some(at) = self.halves.iter().position(meets) else {
            let until = None;
            self.halves.push(Half {
                id,
                entity,
                said,
                until,
            });
            return;
        };
        let other = self.halves.remove(at).entity;
        let ends = self.pair(entity, other);
        let free = !self.links.iter().any(|link| link.ends == ends);
        match self.qos(limits, entity, other) {
            Some((reliable, sealed))
                if free && reliable == said.reliable && sealed <= said.sealed =>
            {
                self.links.push(Link {
                    id,
                    ends,
                    reliable,
                    sealed: said.sealed,
                });
            }
            _ => {
                self.tell(entity, id, 6);
                self.tell(other, id, 6);
            }
        }
    }

    /// Removes an end of a link, or all ends of an interface.
    pub(crate) fn drop_end(&mut self, entity: EntityId, only: Option<LinkId>, code: u16) {
        let dropped = |id: LinkId| only.is_none_or(|only| only == id);
        self.halves
            .retain(|it| it.entity != entity || !dropped(it.id));
        self.told.retain(|&(it, id)| it != entity || !dropped(id));
        let gone = |link: &Link| link.ends.contains(&entity) && dropped(link.id);
        let ended: Vec<Link> = self.links.iter().filter(|it| gone(it)).cloned().collect();
        self.links.retain(|link| !gone(link));
        for link in ended {
            for end in link.ends {
                if end != entity {
                    self.tell(end, link.id, code);
                }
            }
            if only.is_some() {
                self.ended.insert(link.ends);
            }
        }
    }

    pub(crate) fn leave(&mut self, node: NodeId) {
        let entities: Vec<EntityId> = self.interfaces.keys().copied().collect();
        let own: Vec<EntityId> = entities.into_iter().filter(|it| it.node == node).collect();
        for entity in &own {
            self.interfaces.remove(entity);
        }
        for entity in own {
            self.drop_end(entity, None, 5);
        }
        self.sessions.remove(&node);
    }

    pub(crate) fn wait(&mut self, ms: u64) {
        self.now += ms;
        let late = |it: &ConnectedNode| it.resuming && it.greet_until <= self.now;
        let late: Vec<NodeId> = self
            .sessions
            .values()
            .filter(|it| late(it))
            .map(|it| it.node)
            .collect();
        for node in late {
            self.leave(node);
        }
        let now = self.now;
        let (over, rest) = std::mem::take(&mut self.halves)
            .into_iter()
            .partition(|it| it.until.is_some_and(|until| until <= now));
        self.halves = rest;
        let over: Vec<Half> = over;
        for half in over {
            self.tell(half.entity, half.id, 5);
        }
    }

    pub(crate) fn relations(&self) -> Vec<Item> {
        let mut items: Vec<Item> = self
            .links
            .iter()
            .map(|link| Item::Link {
                link: link.id,
                offering: link.ends[0],
                demanding: link.ends[1],
                version: 1,
                reliable: link.reliable,
                sealed: link.sealed,
            })
            .collect();
        items.extend(self.halves.iter().map(|half| Item::Claim {
            link: half.id,
            entity: half.entity,
        }));
        items.sort_by_key(Item::key);
        items
    }
}
