//! The endpoints of the network, which their liveliness tokens describe.

use hiroz_protocol::entity::{EndpointEntity, Entity, NodeEntity};
use hiroz_protocol::qos::{QosDurability, QosHistory};
use hiroz_protocol::{EndpointKind, KeyExprFormatter, RmwZenohFormatter};
use sm2_proto::Name;
use zenoh::key_expr::KeyExpr;

use super::types::RosType;

/// How many messages of a publisher the domain keeps for late joiners at most.
const LATCHED_MAX: u16 = 64;

/// The namespace of the nodes that bridges declare. The name of such a node is that of its bridge.
pub(super) const NAMESPACE: &str = "/sm2";

/// A publisher, subscription, server or client of the network.
#[derive(Debug, PartialEq, Eq)]
pub(super) struct Endpoint {
    pub(super) kind: EndpointKind,
    /// The name of the topic or service.
    pub(super) name: Name,
    pub(super) data: RosType,
    /// How many messages a publisher keeps for late joiners.
    pub(super) latched: u16,
    /// The bridge that has declared it for a domain.
    pub(super) bridge: Option<Name>,
}

/// The key expression of all tokens of a ROS domain.
pub(super) fn tokens(domain_id: u8) -> String {
    format!("{}/{domain_id}/**", RmwZenohFormatter::ADMIN_SPACE)
}

/// The bridge that has declared the node of a token. `None` if the token is that of another node, or of an endpoint.
pub(super) fn bridge(token: &str) -> Option<Name> {
    let key = KeyExpr::try_from(token).ok()?;
    match RmwZenohFormatter::parse_liveliness(&key) {
        Ok(Entity::Node(node)) => bridge_of(&node),
        _ => None,
    }
}

/// The bridge that has declared a node.
fn bridge_of(node: &NodeEntity) -> Option<Name> {
    let is_bridge = node.namespace == NAMESPACE;
    is_bridge.then(|| Name::new(&node.name).ok()).flatten()
}

impl Endpoint {
    /// Reads a token. `None` if it is that of a node, or if the domain has no names for the topic or its type.
    pub(super) fn read(token: &str) -> Option<Self> {
        let key = KeyExpr::try_from(token).ok()?;
        let Ok(Entity::Endpoint(EndpointEntity {
            kind,
            node: Some(node),
            topic,
            type_info,
            qos,
            ..
        })) = RmwZenohFormatter::parse_liveliness(&key)
        else {
            return None;
        };
        let latched = match (qos.durability, qos.history) {
            (QosDurability::Volatile, _) => 0,
            (_, QosHistory::KeepLast(depth)) => u16::try_from(depth).unwrap_or(u16::MAX),
            (_, QosHistory::KeepAll) => LATCHED_MAX,
        };
        Some(Self {
            kind,
            name: Name::typed(&topic).ok()?,
            data: RosType::of_info(&type_info?)?,
            latched: latched.min(LATCHED_MAX),
            bridge: bridge_of(&node),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const HASH: &str = "RIHS01_df668c740482bbd48fb39d76a70dfd4bd59db1288021743503259e948f6b1a18";

    fn token(node: &str, kind: &str, topic: &str, data: &str) -> String {
        format!("@ros2_lv/0/1234abcd/0/11/{kind}/%/{node}/{topic}/{data}/:1:,10:,:,:,,")
    }

    #[test]
    fn a_token_describes_an_endpoint() {
        let string = format!("std_msgs::msg::dds_::String_/{HASH}");
        let talker = Endpoint::read(&token("%/talker", "MP", "%ns%chatter", &string)).unwrap();
        assert_eq!(talker.kind, EndpointKind::Publisher);
        assert_eq!(talker.name.as_str(), "ns/chatter");
        assert_eq!(talker.data.data().name.as_str(), "std_msgs/msg/String");
        assert_eq!((talker.latched, talker.bridge), (10, None));
        let volatile = token("%/talker", "MP", "%chatter", &string).replace(":1:", "::");
        assert_eq!(Endpoint::read(&volatile).unwrap().latched, 0);
        let all = token("%/talker", "MP", "%chatter", &string).replace(",10:", "2,:");
        assert_eq!(Endpoint::read(&all).unwrap().latched, LATCHED_MAX);
        let bridge = Endpoint::read(&token("%sm2/seven", "MS", "%chatter", &string)).unwrap();
        assert_eq!(bridge.kind, EndpointKind::Subscription);
        assert_eq!(bridge.bridge.unwrap().as_str(), "seven");
        let node = "@ros2_lv/0/1234abcd/0/0/NN/%/%sm2/seven";
        assert_eq!(super::bridge(node).unwrap().as_str(), "seven");
        let of_bridge = token("%sm2/seven", "MS", "%chatter", &string);
        for other in ["@ros2_lv/0/1234abcd/0/0/NN/%/%/talker", &of_bridge] {
            assert_eq!(super::bridge(other), None, "{other}");
        }
        for wrong in [
            "@ros2_lv/0/1234abcd/0/0/NN/%/%/talker".to_owned(),
            token("%/talker", "MP", "%ns%%chatter", &string),
            token("%/talker", "MX", "%chatter", &string),
            token(
                "%/talker",
                "MP",
                "%chatter",
                "EMPTY_TOPIC_TYPE/EMPTY_TOPIC_HASH",
            ),
            token(
                "%/talker",
                "MP",
                "%chatter",
                "std_msgs::msg::dds_::String_/none",
            ),
            "@ros2_lv/0/1234abcd/0".to_owned(),
            "**/**".to_owned(),
        ] {
            assert_eq!(Endpoint::read(&wrong), None, "{wrong}");
        }
    }
}
