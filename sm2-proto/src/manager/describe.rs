//! SCHEMA registers the text of a type, and DESCRIBE asks for one (SM2-SCH-001, SM2-SCH-002).

use alloc::string::String;

use super::{Manager, session::Session};
use crate::{
    NodeId, TypeId, Violation,
    control::{Limit, ToNode},
    schema::Schema,
};

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
        let quota = self.limits.count(Limit::SchemaBytesPerSession);
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

/// The share of a quota that a text takes. The name counts as well, or a session could register any
/// number of short texts.
fn cost_bytes(data: &TypeId, text: &str) -> usize {
    data.name.as_str().len() + text.len()
}
