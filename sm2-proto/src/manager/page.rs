//! QUERY: the domain's state, a page at a time (SM2-IFC-007).

use alloc::vec::Vec;
use core::ops::Bound;

use super::Manager;
use crate::{
    InterfaceId, NodeId,
    control::{Cursor, Item, ToNode},
    limits::PAGE_BYTES,
};

impl Manager {
    //= SM2-IFC-007
    pub(super) fn answer_query(&mut self, session: NodeId, after: Option<Cursor>) {
        let mut room = PAGE_BYTES;
        let mut items = Vec::new();
        let mut next = None;
        for item in self.items(after) {
            let Some(left) = room.checked_sub(size_bytes(&item)) else {
                next = items.last().map(position);
                break;
            };
            room = left;
            items.push(item);
        }
        let revision = self.revision;
        self.send(
            session,
            &ToNode::Page {
                revision,
                items,
                next,
            },
        );
    }

    /// Nodes and interfaces after a position, in ascending order.
    fn items(&self, after: Option<Cursor>) -> impl Iterator<Item = Item> {
        let from = after.map_or(Bound::Unbounded, |cursor| Bound::Included(cursor.node));
        let rest = self.sessions.range((from, Bound::Unbounded));
        rest.flat_map(move |(&node, session)| {
            let within = after.filter(|cursor| cursor.node == node);
            let name = session.name().filter(|_| within.is_none());
            let itself = name.map(|name| Item::Node {
                node,
                name: name.clone(),
                uid: session.credentials().uid,
                pid: session.credentials().pid,
            });
            let after = within.map_or(InterfaceId(0), |cursor| cursor.interface);
            let interfaces = session.after(after);
            let interfaces = interfaces.map(move |(interface, contract, links)| Item::Interface {
                node,
                interface,
                contract: contract.clone(),
                links: u32::try_from(links).unwrap_or(u32::MAX),
            });
            itself.into_iter().chain(interfaces)
        })
    }
}

const fn position(item: &Item) -> Cursor {
    match item {
        Item::Node { node, .. } => Cursor {
            node: *node,
            interface: InterfaceId(0),
        },
        Item::Interface {
            node, interface, ..
        } => Cursor {
            node: *node,
            interface: *interface,
        },
    }
}

fn size_bytes(item: &Item) -> usize {
    postcard::experimental::serialized_size(item).unwrap_or(PAGE_BYTES)
}
