//! SCHEMA and DESCRIBE: the texts of types, as long as somebody who registered them is
//! there (SM2-SCH-001, SM2-SCH-002).

use alloc::{collections::BTreeMap, string::String};

use super::{Manager, session::Session};
use crate::{NodeId, TypeId, Violation, control::ToNode, schema::Schema};

#[derive(Clone, Debug, PartialEq, Eq, Hash)]
struct Registered {
    text: String,
    /// How many sessions registered it.
    sessions: usize,
}

#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub(super) struct Schemas(BTreeMap<TypeId, Registered>);

impl Manager {
    //= SM2-SCH-001
    pub(super) fn register(
        &mut self,
        node: NodeId,
        data: TypeId,
        text: String,
    ) -> Result<(), Violation> {
        let schema = Schema::parse(&text).map_err(|_| violation!(BadSchema, "SM2-SCH-001"))?;
        if schema.hash() != data.hash {
            return Err(violation!(BadSchema, "SM2-SCH-001"));
        }
        let quota = self.policy.schema_bytes_per_session;
        if let Some(record) = self.sessions.get_mut(&node).and_then(Session::node_mut)
            && record.register(&data, cost_bytes(&data, &text), quota)
        {
            self.schemas.insert(data, text);
        }
        Ok(())
    }

    //= SM2-SCH-002
    pub(super) fn describe(&mut self, node: NodeId, data: TypeId) {
        let text = self.schemas.get(&data).cloned();
        self.send(node, &ToNode::Described { data, text });
    }
}

/// What counts of a text: also its name, or there could be any number of short ones.
fn cost_bytes(data: &TypeId, text: &str) -> usize {
    data.name.as_str().len() + text.len()
}

impl Schemas {
    pub(super) const fn new() -> Self {
        Self(BTreeMap::new())
    }

    /// The text of a type, if anybody registered it.
    fn get(&self, data: &TypeId) -> Option<&String> {
        Some(&self.0.get(data)?.text)
    }

    /// One more session has it. The text stays that of the first one.
    fn insert(&mut self, data: TypeId, text: String) {
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
