//! The texts of types that sessions have registered, each as long as one of these sessions lives.

use alloc::{collections::BTreeMap, string::String};

use crate::TypeId;

#[derive(Clone, Debug, PartialEq, Eq, Hash)]
struct Registered {
    text: String,
    /// How many sessions registered it.
    sessions: usize,
}

#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub(super) struct Schemas(BTreeMap<TypeId, Registered>);

impl Schemas {
    pub(super) const fn new() -> Self {
        Self(BTreeMap::new())
    }

    /// The text of a type, if anybody registered it.
    pub(super) fn get(&self, data: &TypeId) -> Option<&String> {
        Some(&self.0.get(data)?.text)
    }

    /// One more session has it. The text stays that of the first one.
    pub(super) fn insert(&mut self, data: TypeId, text: String) {
        let registered = self
            .0
            .entry(data)
            .or_insert(Registered { text, sessions: 0 });
        registered.sessions += 1;
    }

    /// One session less has it.
    pub(super) fn remove(&mut self, data: &TypeId) {
        match self.0.get_mut(data) {
            Some(registered) if registered.sessions > 1 => registered.sessions -= 1,
            _ => drop(self.0.remove(data)),
        }
    }

    /// Whether these are all that the sessions registered, and no more.
    pub(super) fn are<'a>(&self, registered: impl Iterator<Item = &'a TypeId>) -> bool {
        let mut recount = BTreeMap::new();
        for data in registered {
            *recount.entry(data).or_insert(0) += 1;
        }
        let counts = self.0.iter().map(|(data, it)| (data, it.sessions));
        counts.eq(recount)
    }
}
