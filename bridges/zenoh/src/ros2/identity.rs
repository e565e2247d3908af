//! The node of ROS 2 that owns all interfaces of a bridge, and its endpoints.

use hiroz_protocol::qos::QosProfile;
use hiroz_protocol::{
    EndpointEntity, EndpointKind, KeyExprFormatter, NodeEntity, RmwZenohFormatter,
};
use sm2_bridge_core::BridgeError;
use sm2_proto::Name;
use zenoh::liveliness::LivelinessToken;

use super::attachment::Gid;
use super::graph::NAMESPACE;
use super::types::RosType;
use crate::network::Network;

/// The node `/sm2/NAME`. Leaves when it is dropped.
pub(super) struct Identity {
    node: NodeEntity,
    _token: LivelinessToken,
    /// The number of the last endpoint.
    last_id: usize,
}

impl Identity {
    pub(super) fn declare(
        name: &Name,
        domain_id: u8,
        network: &Network,
    ) -> Result<Self, BridgeError> {
        let node = NodeEntity::new(
            domain_id.into(),
            network.id(),
            0,
            name.to_string(),
            NAMESPACE.to_owned(),
            String::new(),
        );
        let token = RmwZenohFormatter::node_liveliness_key_expr(&node).map_err(named)?;
        Ok(Self {
            node,
            _token: network.declare_token(token.0)?,
            last_id: 0,
        })
    }

    /// A new endpoint of the node.
    pub(super) fn endpoint(
        &mut self,
        kind: EndpointKind,
        name: &Name,
        data: &RosType,
        qos: QosProfile,
    ) -> EndpointEntity {
        self.last_id += 1;
        EndpointEntity {
            id: self.last_id,
            node: Some(self.node.clone()),
            kind,
            topic: format!("/{name}"),
            type_info: data.info(),
            qos,
        }
    }
}

fn named(error: zenoh::Error) -> BridgeError {
    crate::network::refused("name an endpoint")(error)
}

/// The key expression of the topic or service.
pub(super) fn key(endpoint: &EndpointEntity) -> Result<String, BridgeError> {
    let key = RmwZenohFormatter::topic_key_expr(endpoint).map_err(named)?;
    Ok(key.to_string())
}

/// Shows an endpoint to the nodes of ROS 2.
pub(super) fn declare_token(
    endpoint: &EndpointEntity,
    network: &Network,
) -> Result<LivelinessToken, BridgeError> {
    network.declare_token(token_key(endpoint, network)?)
}

/// The key expression of the token of an endpoint.
pub(super) fn token_key(
    endpoint: &EndpointEntity,
    network: &Network,
) -> Result<String, BridgeError> {
    let key = RmwZenohFormatter::liveliness_key_expr(endpoint, &network.id()).map_err(named)?;
    Ok(key.0.to_string())
}

/// A number that no other endpoint of the network has: the number of the session, and that of the endpoint.
pub(super) fn gid(endpoint: &EndpointEntity, network: &Network) -> Gid {
    let mut gid = network.id().to_le_bytes();
    for (byte, id) in gid.iter_mut().zip(endpoint.id.to_le_bytes()) {
        *byte ^= id;
    }
    gid
}
