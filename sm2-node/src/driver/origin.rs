//! The link that messages came from.

use std::fmt;
use std::sync::{Arc, Weak};

use sm2_proto::control::LinkPeer;

use super::token::LinkToken;

/// The link that a message came from. All messages of the link share this value, so each costs one reference count. It
/// keeps neither the node nor its interface alive.
#[derive(Debug)]
pub(crate) struct Origin {
    pub(crate) token: LinkToken,
    /// The other end of the link.
    pub(crate) peer: Arc<LinkPeer>,
    pub(crate) interface: Weak<dyn GiveBack>,
}

/// The interface that messages are given back to.
pub(crate) trait GiveBack: fmt::Debug + Send + Sync {
    /// Gives back the message with this sequence number, for the application.
    fn give_back(&self, link: LinkToken, sequence: u64);
}
