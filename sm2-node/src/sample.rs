//! Received messages.

use std::fmt;
use std::ops::Deref;

use sm2_proto::{Contract, Instant, Name, TypeId};

use crate::handle::receive::{Receipt, Received};
use crate::{Message, RecvError};

/// A received message. Dereferences to it; dropping it releases the message.
///
/// The memory does not change as long as the sample exists, even after the subscriber, the node, the
/// publisher or the Manager has ended: the publisher must not write to a slot before it is released
/// (SM2-PAY-005, SM2-OPN-010). A subscriber that does not trust the publisher requires
/// [sealed](crate::SubscriberBuilder::sealed) messages. A message that came
/// [in a cell](crate#how-a-message-travels) is a copy, and was released when it was taken.
///
/// ```
/// # fn main() -> Result<(), Box<dyn std::error::Error>> {
/// # let domain = sm2_node::testing::TestDomain::new()?;
/// # let lidar = domain.node("lidar")?;
/// # let scans = lidar.publisher_builder::<[f32]>("scan").latched(1).declare()?;
/// # scans.publish(&[1.0, 2.5])?;
/// # let node = domain.node("map")?;
/// let subscriber = node.subscriber::<[f32]>("scan")?;
/// let scan = subscriber.recv()?;
/// drop((subscriber, node));                       // the sample is valid nevertheless
/// assert_eq!((scan[1], scan.publisher().as_str()), (2.5, "lidar"));
/// let age = sm2_node::now().since(scan.source_time());
/// println!("message {} is {age:?} old", scan.sequence());
/// # Ok(())
/// # }
/// ```
pub struct Sample<T: Message + ?Sized> {
    /// Before the receipt, so that it is dropped first: the view may refer to the slot that the receipt
    /// releases.
    view: T::View,
    sequence: u64,
    time: Instant,
    lost: u64,
    receipt: Receipt,
}

impl<T: Message + ?Sized> Sample<T> {
    #[inline]
    pub(crate) fn new(received: Received) -> Result<Self, RecvError> {
        let Received {
            receipt,
            header,
            bytes,
        } = received;
        let view = match T::view_in_place(bytes) {
            Ok(view) => view,
            Err(reason) => {
                let publisher = receipt.peer().name.clone();
                return Err(RecvError::Payload { publisher, reason });
            }
        };
        Ok(Self {
            view,
            sequence: header.id,
            time: header.time,
            lost: header.lost,
            receipt,
        })
    }

    /// The number of the publication, from 1: the same for every subscriber.
    #[must_use]
    pub const fn sequence(&self) -> u64 {
        self.sequence
    }

    /// The time of publication, in nanoseconds of the host's monotonic clock ([`now`](crate::now)).
    #[must_use]
    pub const fn source_time(&self) -> Instant {
        self.time
    }

    /// The number of this publisher's messages that were lost between the previous sample and this one.
    #[must_use]
    pub const fn lost(&self) -> u64 {
        self.lost
    }

    /// The name of the publisher's node.
    #[must_use]
    pub fn publisher(&self) -> &Name {
        &self.receipt.peer().name
    }

    /// The type that the publisher declared: the type of the subscriber, unless that accepts any type.
    #[must_use]
    pub fn type_id(&self) -> Option<&TypeId> {
        match &self.receipt.peer().contract {
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
            .field("publisher", &self.receipt.peer().name)
            .field("message", &&**self)
            .finish()
    }
}
