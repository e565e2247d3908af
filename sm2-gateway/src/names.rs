//! The names of a gateway's nodes and of its status service.

use sm2_proto::{Name, NameError};

const GATEWAY: &str = "gateway";
const REMOTE: &str = "remote";

/// The name of the gateway's own node.
pub(crate) fn own_node(gateway: &Name) -> Result<Name, NameError> {
    Name::new(&format!("{GATEWAY}/{gateway}"))
}

/// The name of the node whose publishers and servers stand for those of a peer.
pub(crate) fn remote_node(peer: &Name) -> Result<Name, NameError> {
    Name::new(&format!("{REMOTE}/{peer}"))
}

/// The name of the service that answers status requests of a gateway.
///
/// # Errors
/// The name is too long.
pub fn status_service(gateway: &Name) -> Result<Name, NameError> {
    Name::new(&format!("{GATEWAY}/{gateway}/status"))
}

/// True if a node of this name stands for a peer of a gateway.
#[must_use]
pub fn is_remote(node: &Name) -> bool {
    node.as_str().starts_with("remote/")
}

/// True if a gateway created the node. Its interfaces are never carried to peers.
pub(crate) fn is_of_gateway(node: &Name) -> bool {
    is_remote(node) || node.as_str().starts_with("gateway/")
}
