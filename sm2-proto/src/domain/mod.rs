//! The mirror of a domain: its nodes, interfaces and links.
//!
//! | to do | call |
//! | --- | --- |
//! | keep a mirror | [`Mirror`] makes the requests and takes the answers |
//! | list items | [`Domain::nodes`], [`Domain::interfaces`], [`Domain::links`], [`Domain::find`] |
//!
//! A [`Domain`] holds the items that a Manager sent, and nothing else. An item may name nodes that
//! the domain does not show. All methods then answer without them; none panics.

#[cfg(feature = "fuzzing")]
pub(crate) mod fuzz;
mod mirror;
mod view;

use alloc::{collections::BTreeMap, vec::Vec};

pub use self::{
    mirror::{Ask, BrokenAnswer, Mirror},
    view::{InterfaceView, LinkView, NodeView},
};
use crate::control::{Change, Item, Key};

/// All items of a domain, as of one revision.
#[derive(Clone, Debug, Default, PartialEq, Eq, Hash)]
pub struct Domain {
    revision: u64,
    items: BTreeMap<Key, Item>,
}

impl Domain {
    /// A domain without items.
    #[must_use]
    pub const fn new() -> Self {
        Self {
            revision: 0,
            items: BTreeMap::new(),
        }
    }

    /// The revision of these items. Revisions of different Managers cannot be compared.
    #[must_use]
    pub const fn revision(&self) -> u64 {
        self.revision
    }

    /// All items in the order of their keys.
    pub fn items(&self) -> impl Iterator<Item = &Item> {
        self.items.values()
    }

    /// One item.
    #[must_use]
    pub fn get(&self, key: &Key) -> Option<&Item> {
        self.items.get(key)
    }

    /// Adds the items of a page.
    pub fn page(&mut self, items: impl IntoIterator<Item = Item>) {
        self.items
            .extend(items.into_iter().map(|item| (item.key(), item)));
    }

    /// Applies changes, which lead to `revision`.
    pub fn apply(&mut self, revision: u64, changes: impl IntoIterator<Item = Change>) {
        for change in changes {
            match change {
                Change::Set { item } => drop(self.items.insert(item.key(), item)),
                Change::Removed { key } => drop(self.items.remove(&key)),
            }
        }
        self.revision = revision;
    }

    /// Whether the change makes a difference here.
    fn makes_a_difference(&self, change: &Change) -> bool {
        match change {
            Change::Set { item } => self.get(&item.key()) != Some(item),
            Change::Removed { key } => self.items.contains_key(key),
        }
    }

    /// The changes that turn this domain into `newer`: first the items that are gone, then those
    /// that are new or different.
    #[must_use]
    pub fn difference(&self, newer: &Self) -> Vec<Change> {
        let gone = self.items.keys().filter(|key| newer.get(key).is_none());
        let gone = gone.map(|&key| Change::Removed { key });
        let set = newer.items.iter();
        let set = set.filter(|(key, item)| self.get(key) != Some(item));
        let set = set.map(|(_, item)| Change::Set { item: item.clone() });
        gone.chain(set).collect()
    }
}
