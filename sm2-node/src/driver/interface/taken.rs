//! Messages that were taken from links for the application.

use std::sync::Arc;

use sm2_proto::control::LinkPeer;
use sm2_proto::link::{Delivery, TooManyBorrowed};

use crate::driver::token::LinkToken;
use crate::payload::Source;

/// A message that the application holds.
#[derive(Debug)]
pub(crate) struct Taken {
    pub(crate) token: LinkToken,
    pub(crate) peer: Arc<LinkPeer>,
    pub(crate) delivery: Delivery,
    pub(crate) source: Source,
}

/// A message is ready, but the application holds as many messages of this peer as it may.
#[derive(Debug)]
pub(crate) struct Full {
    pub(crate) error: TooManyBorrowed,
    pub(crate) peer: Arc<LinkPeer>,
}
