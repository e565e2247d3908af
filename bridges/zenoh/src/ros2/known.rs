//! The types of ROS 2 that the domain and the network use.

use std::collections::{BTreeSet, HashMap};

use sm2_node::Node;
use sm2_proto::TypeId;

use super::types::RosType;

/// The types that are known, by the types of the domain.
#[derive(Default)]
pub(super) struct Known {
    /// Those of the endpoints of the network.
    network: HashMap<TypeId, RosType>,
    /// Those whose schema text nodes of the domain have registered.
    domain: HashMap<TypeId, RosType>,
    /// Those of services, by the types of their requests and replies.
    services: HashMap<(TypeId, TypeId), RosType>,
    /// The types that are not of ROS 2. Each was reported once.
    unknown: BTreeSet<TypeId>,
}

impl Known {
    /// Replaces the types of the network.
    pub(super) fn set_network(&mut self, types: impl Iterator<Item = RosType>) {
        self.network = types.map(|it| (it.data(), it)).collect();
    }

    /// The type of a topic. Reports a type that is not of ROS 2 once.
    pub(super) fn message(&mut self, node: &Node, data: &TypeId) -> Option<RosType> {
        let known = self.network.get(data).or_else(|| self.domain.get(data));
        if let Some(known) = known {
            return Some(known.clone());
        }
        let found = describe(node, data).and_then(|text| RosType::of_schema(data, &text));
        match &found {
            Some(found) => drop(self.domain.insert(data.clone(), found.clone())),
            None => self.report_unknown(data),
        }
        found
    }

    /// The type of a service by those of its requests and replies. Reports one that is not of ROS 2 once.
    pub(super) fn service(
        &mut self,
        node: &Node,
        request: &TypeId,
        reply: &TypeId,
    ) -> Option<RosType> {
        let pair = (request.clone(), reply.clone());
        if let Some(known) = self.services.get(&pair) {
            return Some(known.clone());
        }
        let texts = describe(node, request).zip(describe(node, reply));
        let found = texts
            .and_then(|(asked, replied)| RosType::of_service((request, &asked), (reply, &replied)));
        match &found {
            Some(found) => drop(self.services.insert(pair, found.clone())),
            None => self.report_unknown(request),
        }
        found
    }

    fn report_unknown(&mut self, data: &TypeId) {
        if self.unknown.insert(data.clone()) {
            tracing::warn!(
                r#type = %data.name,
                "is not a type of ROS 2, or no node has registered its definition: it is not carried"
            );
        }
    }
}

/// The schema text of a type. The next change of the domain is the next attempt, if the Manager does not answer.
fn describe(node: &Node, data: &TypeId) -> Option<String> {
    node.describe(data).ok().flatten()
}
