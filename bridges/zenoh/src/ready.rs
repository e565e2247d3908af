//! The events that a bridge waits for.

use std::sync::Arc;

use sm2_bridge_core::domain::{Service, Topic};

/// The thing that is ready.
#[derive(Clone, Debug)]
pub(crate) enum Ready {
    Domain,
    Network,
    Topic(Arc<Topic>),
    /// A server that stands for those of the network has requests.
    Server(Arc<Service>),
    /// A call of the network has a reply.
    Call(u64),
}
