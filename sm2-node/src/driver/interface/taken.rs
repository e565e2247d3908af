//! Messages that were taken from links for the application.

use std::sync::Arc;

use sm2_proto::Instant;
use sm2_proto::control::LinkPeer;
use sm2_proto::link::{Delivery, Status, TooManyBorrowed};

use crate::driver::origin::Held;
use crate::driver::token::LinkToken;
use crate::payload::Source;

/// A message that the application holds.
#[derive(Debug)]
pub(crate) struct Taken {
    pub(crate) origin: Held,
    pub(crate) header: Header,
    pub(crate) source: Source,
}

impl Taken {
    /// The link and the number of the message, if it has to be released.
    #[inline]
    pub(crate) fn place(&self) -> Option<(LinkToken, u64)> {
        let place = (self.origin.token, self.header.sequence);
        self.origin.is_released().then_some(place)
    }
}

/// A [`Delivery`] without its payload.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Header {
    pub(crate) sequence: u64,
    pub(crate) id: u64,
    pub(crate) time: Instant,
    pub(crate) status: Status,
    pub(crate) lost: u64,
    pub(crate) len: u64,
}

impl Header {
    #[inline]
    pub(in crate::driver) const fn of<C>(delivery: &Delivery<C>) -> Self {
        Self {
            sequence: delivery.sequence,
            id: delivery.id,
            time: delivery.time,
            status: delivery.status,
            lost: delivery.lost,
            len: delivery.len,
        }
    }
}

/// A message is ready, but the application holds as many messages of this peer as it may.
#[derive(Debug)]
pub(crate) struct Full {
    pub(crate) error: TooManyBorrowed,
    pub(crate) peer: Arc<LinkPeer>,
}
