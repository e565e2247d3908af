//! The part of a bridge that is in the domain.

use sm2_gateway::DomainLocation;
use sm2_node::Node;
use sm2_node::domain::Watch;
use sm2_proto::Name;

use crate::error::BridgeError;

/// The nodes of a bridge, and its view of the domain.
pub struct Member {
    /// The node `bridge/NAME`, which subscribes.
    pub node: Node,
    /// The node `remote/NAME`, which publishes.
    pub remote: Node,
    /// The domain, which is known already: a message of the network may be the first event.
    pub watch: Watch,
}

impl Member {
    /// Joins the domain as the bridge with this name.
    ///
    /// # Errors
    ///
    /// See [`BridgeError`].
    pub fn join(domain: &DomainLocation, name: &Name) -> Result<Self, BridgeError> {
        let connect = |role: &str| {
            let name = Name::new(&format!("{role}/{name}")).map_err(BridgeError::Name)?;
            domain.connect(name.as_str()).map_err(BridgeError::Connect)
        };
        let node = connect("bridge")?;
        let remote = connect("remote")?;
        let mut watch = node.watch();
        watch.wait()?;
        Ok(Self {
            node,
            remote,
            watch,
        })
    }
}
