//! The texts of types that sessions have registered, each as long as one of these sessions lives.

use alloc::{collections::BTreeMap, string::String};

use crate::TypeId;

#[derive(Clone, Debug, PartialEq, Eq, Hash)]
struct Registered {
    text: String,
    /// The number of sessions that registered the text.
    sessions: usize,
}

#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub(super) struct Schemas(BTreeMap<TypeId, Registered>);

impl Schemas {
    pub(super) const fn new() -> Self {
        Self(BTreeMap::new())
    }

    /// The text of a type, if a session registered one.
    pub(super) fn get(&self, data: &TypeId) -> Option<&String> {
        Some(&self.0.get(data)?.text)
    }

    /// Adds one session to a text. The text of the first session stays.
    pub(super) fn insert(&mut self, data: TypeId, text: String) {
        let registered = self
            .0
            .entry(data)
            .or_insert(Registered { text, sessions: 0 });
        registered.sessions += 1;
    }

    /// Removes one session from a text.
    pub(super) fn remove(&mut self, data: &TypeId) {
        match self.0.get_mut(data) {
            Some(registered) if registered.sessions > 1 => registered.sessions -= 1,
            _ => drop(self.0.remove(data)),
        }
    }

    /// Whether these are exactly the registrations of all sessions.
    pub(super) fn are<'a>(&self, registered: impl Iterator<Item = &'a TypeId>) -> bool {
        let mut recount = BTreeMap::new();
        for data in registered {
            *recount.entry(data).or_insert(0) += 1;
        }
        let counts = self.0.iter().map(|(data, it)| (data, it.sessions));
        counts.eq(recount)
    }
}
