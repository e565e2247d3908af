//! The two sides of a bridge.

use sm2_bridge_core::domain::has_bridge;
use sm2_node::Node;
use sm2_node::domain::Domain;
use sm2_proto::Name;

use crate::config::Config;
use crate::network::Network;

/// The domain and the network, and the rules between them.
pub(crate) struct Sides<'a> {
    pub(crate) config: &'a Config,
    pub(crate) domain: &'a Domain,
    /// The node that takes part in the domain.
    pub(crate) node: &'a Node,
    /// The node that stands for the network.
    pub(crate) remote: &'a Node,
    pub(crate) network: &'a Network,
}

impl Sides<'_> {
    /// Whether a bridge of this name is one of the domain: it stands for the domain.
    pub(crate) fn has_bridge(&self, bridge: &Name) -> bool {
        has_bridge(self.domain, bridge)
    }
}
