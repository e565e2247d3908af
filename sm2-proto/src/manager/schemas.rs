//! The texts of types that sessions have registered, each as long as one of these sessions lives.
//! SCHEMA registers one, and DESCRIBE asks for one (SM2-SCH-001, SM2-SCH-002).

use alloc::{collections::BTreeMap, string::String};

use super::{node_record::NodeRecord, outbox::Outbox};
use crate::{
    NodeId, TypeId, Violation,
    control::{Limit, Limits, SchemaText, ToNode},
    schema::Schema,
};

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

    /// DESCRIBE: sends the text of a type, if a session registered one.
    //= SM2-SCH-002
    pub(super) fn describe(&self, node: NodeId, data: TypeId, outbox: &mut Outbox) {
        let text = self.0.get(&data).map(|it| it.text.clone());
        outbox.send(node, &ToNode::Described { data, text });
    }

    /// Registers a text for a node, as far as the quota of the node allows.
    //= SM2-SCH-001
    pub(super) fn register(
        &mut self,
        record: &mut NodeRecord,
        SchemaText { data, text }: SchemaText,
        limits: &Limits,
    ) -> Result<(), Violation> {
        let schema = Schema::parse(&text).map_err(|_| violation!(BadSchema, "SM2-SCH-001"))?;
        if schema.hash() != data.hash {
            return Err(violation!(BadSchema, "SM2-SCH-001"));
        }
        let quota = limits.count(Limit::SchemaBytesPerSession);
        if record.register(&data, cost_bytes(&data, &text), quota) {
            self.insert(data, text);
        }
        Ok(())
    }

    /// Adds one session to a text. The text of the first session stays.
    fn insert(&mut self, data: TypeId, text: String) {
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

/// The share of a quota that a text takes. The name counts as well, or a session could register any
/// number of short texts.
fn cost_bytes(data: &TypeId, text: &str) -> usize {
    data.name.as_str().len() + text.len()
}
