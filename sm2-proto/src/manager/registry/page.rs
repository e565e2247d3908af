//! QUERY: the state of the domain, a page at a time (SM2-IFC-007).

use alloc::vec::Vec;

use super::Registry;
use crate::{
    EntityId, LinkId, NodeId,
    control::{Item, Key, Page},
    limits::PAGE_BYTES,
    manager::links::Pair,
};

/// How many items that the session may not see a page may pass over.
const HIDDEN_MAX: usize = 512;

impl Registry {
    //= SM2-IFC-007, SM2-ACC-010
    pub(in crate::manager) fn page(&self, viewer: NodeId, after: Option<Key>) -> Page {
        let mut room = PAGE_BYTES;
        let mut items = Vec::new();
        let (mut last, mut next) = (None, None);
        let mut hidden = 0;
        for item in self.items(after) {
            if !self.access.sees(viewer, &item, &self.sessions) {
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
        Page {
            revision: self.log.revision(),
            items,
            next,
        }
    }

    /// The item with this key, if there is one.
    pub(super) fn item(&self, key: Key) -> Option<Item> {
        match key {
            Key::Domain => Some(self.domain()),
            Key::Member { entity } => self.sessions.item(entity),
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
        let members = members.into_iter().flat_map(|it| self.sessions.items(it));
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

    fn domain(&self) -> Item {
        let limits = self.limits.into();
        Item::Domain { limits }
    }
}

fn size_bytes(item: &Item) -> usize {
    postcard::experimental::serialized_size(item).unwrap_or(PAGE_BYTES)
}
