//! What a gateway's nodes are called.

use sm2_proto::{Name, NameError};

const OWN: &str = "gateway";
const REMOTE: &str = "remote";

/// The gateway's own node.
pub(crate) fn own_node(gateway: &Name) -> Result<Name, NameError> {
    Name::new(&format!("{OWN}/{gateway}"))
}

/// The node that stands for a peer.
pub(crate) fn remote_node(peer: &Name) -> Result<Name, NameError> {
    Name::new(&format!("{REMOTE}/{peer}"))
}

/// The service that tells how a gateway is.
///
/// # Errors
/// The name is too long.
pub fn status_service(gateway: &Name) -> Result<Name, NameError> {
    Name::new(&format!("{OWN}/{gateway}/status"))
}

/// Whether a node of this name stands for somebody outside of the domain.
#[must_use]
pub fn is_remote(node: &Name) -> bool {
    node.as_str().starts_with("remote/")
}

/// Whether it is a gateway's own: neither what it has nor what it wants is the domain's.
pub(crate) fn is_gateways(node: &Name) -> bool {
    is_remote(node) || node.as_str().starts_with("gateway/")
}
