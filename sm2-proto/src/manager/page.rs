//! QUERY: the state of the domain, a page at a time (SM2-IFC-007).

use alloc::vec::Vec;

use super::{Manager, links::Pair, phase::Phase, session::Session};
use crate::{
    EntityId, LinkId, NodeId,
    control::{Item, Key, Page, ToNode},
    limits::PAGE_BYTES,
};

/// How many items that the session may not see a page may pass over.
const HIDDEN_MAX: usize = 512;

impl Manager {
    //= SM2-IFC-007, SM2-ACC-010
    pub(super) fn answer_query(&mut self, node: NodeId, after: Option<Key>) {
        let mut room = PAGE_BYTES;
        let mut items = Vec::new();
        let (mut last, mut next) = (None, None);
        let mut hidden = 0;
        for item in self.items(after) {
            if !self.sees(node, &item) {
                hidden += 1;
                last = Some(item.key());
                if hidden == HIDDEN_MAX {
                    next = last;
                    break;
                }
                continue;
            }
            let Some(left) = room.checked_sub(size_bytes(&item)) else {
                next = last;
                break;
            };
            room = left;
            last = Some(item.key());
            items.push(item);
        }
        let revision = self.log.revision();
        self.send(
            node,
            &ToNode::Page(Page {
                revision,
                items,
                next,
            }),
        );
    }

    /// The item with this key, if there is one.
    pub(super) fn item(&self, key: Key) -> Option<Item> {
        match key {
            Key::Domain => Some(self.domain()),
            Key::Member { entity } => {
                let session = self.sessions.get(&entity.node)?;
                if entity == EntityId::node(entity.node) {
                    node_item(entity.node, session)
                } else {
                    session.node()?.member(entity)
                }
            }
            Key::Link { link, offering } => {
                let item = self.links.item(link, offering)?;
                Some(self.as_announced(item))
            }
            Key::Claim { link, entity } => self.claims.item(link, entity),
            Key::Unlinked {
                offering,
                demanding,
            } => self.unlinked_pairs.item(Pair {
                offering,
                demanding,
            }),
        }
    }

    /// All items after a key, in the order of their keys.
    fn items(&self, after: Option<Key>) -> impl Iterator<Item = Item> {
        let domain = after.is_none().then(|| self.domain());
        // Each kind of item starts after a key that no item has, or after the key in `after`.
        let after = after.unwrap_or(Key::Domain);
        let members = match after {
            Key::Domain => Some(EntityId::FIRST),
            Key::Member { entity } => Some(entity),
            _ => None,
        };
        let links = match after {
            Key::Domain | Key::Member { .. } => Some((LinkId::FIRST, EntityId::FIRST)),
            Key::Link { link, offering } => Some((link, offering)),
            _ => None,
        };
        let claims = match after {
            Key::Claim { link, entity } => Some((link, entity)),
            Key::Unlinked { .. } => None,
            _ => Some((LinkId::FIRST, EntityId::FIRST)),
        };
        let unlinked = match after {
            Key::Unlinked {
                offering,
                demanding,
            } => (offering, demanding),
            _ => (EntityId::FIRST, EntityId::FIRST),
        };
        let members = members.into_iter().flat_map(|it| self.members(it));
        let links = links.into_iter().flat_map(|it| self.links.items(it));
        let links = links.map(|it| self.as_announced(it));
        let claims = claims.into_iter().flat_map(|it| self.claims.items(it));
        let unlinked = self.unlinked_pairs.items(unlinked);
        let domain = domain.into_iter();
        domain
            .chain(members)
            .chain(links)
            .chain(claims)
            .chain(unlinked)
    }

    /// The item of a link, which shows whether its nodes know it.
    //= SM2-LNK-007
    fn as_announced(&self, item: Item) -> Item {
        match item {
            Item::Link {
                link,
                offering,
                demanding,
                ..
            } if self.pending_links.contains(offering.node, link) => Item::Waiting {
                link,
                offering,
                demanding,
            },
            item => item,
        }
    }

    /// The nodes, interfaces and refusals after an id.
    fn members(&self, after: EntityId) -> impl Iterator<Item = Item> {
        let rest = self.sessions.range(after.node..);
        rest.flat_map(move |(&node, session)| {
            let within = node == after.node;
            let itself = if within {
                None
            } else {
                node_item(node, session)
            };
            let after = if within { after } else { EntityId::node(node) };
            let record = session.node().into_iter();
            itself
                .into_iter()
                .chain(record.flat_map(move |it| it.members(after)))
        })
    }

    fn domain(&self) -> Item {
        let limits = self.limits.into();
        Item::Domain { limits }
    }
}

/// A session as an item, once it is welcomed.
fn node_item(node: NodeId, session: &Session) -> Option<Item> {
    Some(Item::Node {
        node,
        name: session.node()?.name().clone(),
        uid: session.credentials().uid,
        pid: session.credentials().pid,
        resuming: session.phase() == Phase::Resuming,
        max_links: session.node()?.max_links(),
    })
}

fn size_bytes(item: &Item) -> usize {
    postcard::experimental::serialized_size(item).unwrap_or(PAGE_BYTES)
}
