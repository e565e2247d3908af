//! Received messages.

use std::fmt;
use std::ops::Deref;
use std::sync::Arc;

use sm2_proto::control::Peer;
use sm2_proto::{Contract, Instant, Name, TypeId};

use crate::handle::receive::{Receipt, Received};
use crate::{Message, RecvError};

/// One received message. Dereferences to it; dropping it gives it back.
///
/// Nobody writes to its memory as long as it lives, also when its subscriber, its node, the
/// publisher or the Manager are gone: a publisher that follows the specification never
/// writes again to what a link ended with. Against one that does not, demand
/// [sealed](crate::SubscriberBuilder::sealed) messages.
pub struct Sample<T: Message + ?Sized> {
    /// Before the receipt: what is given back is not looked at any more.
    view: T::View,
    sequence: u64,
    time: Instant,
    lost: u64,
    peer: Arc<Peer>,
    _receipt: Receipt,
}

impl<T: Message + ?Sized> Sample<T> {
    #[inline]
    pub(crate) fn new(received: Received) -> Result<Self, RecvError> {
        let Received {
            peer,
            delivery,
            bytes,
            receipt,
        } = received;
        let view = match T::view_in_place(bytes) {
            Ok(view) => view,
            Err(reason) => {
                let publisher = peer.name.clone();
                return Err(RecvError::Payload { publisher, reason });
            }
        };
        Ok(Self {
            view,
            sequence: delivery.id,
            time: delivery.time,
            lost: delivery.lost,
            peer,
            _receipt: receipt,
        })
    }

    /// The publisher's count of its publications, from 1: the same for every subscriber.
    #[must_use]
    pub const fn sequence(&self) -> u64 {
        self.sequence
    }

    /// When it was published, in nanoseconds of the host's monotonic clock
    /// ([`now`](crate::now)).
    #[must_use]
    pub const fn source_time(&self) -> Instant {
        self.time
    }

    /// How many publications of this publisher were lost between the message that was
    /// taken before and this one.
    #[must_use]
    pub const fn lost(&self) -> u64 {
        self.lost
    }

    /// The name of the publisher's node.
    #[must_use]
    pub fn publisher(&self) -> &Name {
        &self.peer.name
    }

    /// The type that the publisher declared: the subscriber's own, unless that takes any type.
    #[must_use]
    pub fn type_id(&self) -> Option<&TypeId> {
        match &self.peer.contract {
            Contract::Publisher { data, .. } => Some(data),
            _ => None,
        }
    }
}

impl<T: Message + ?Sized> Deref for Sample<T> {
    type Target = T;

    fn deref(&self) -> &T {
        &self.view
    }
}

impl<T: Message + ?Sized + fmt::Debug> fmt::Debug for Sample<T> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Sample")
            .field("sequence", &self.sequence)
            .field("publisher", &self.peer.name)
            .field("message", &&**self)
            .finish()
    }
}
