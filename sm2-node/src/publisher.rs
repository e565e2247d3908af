//! Sending the messages of a topic.

use std::marker::PhantomData;
use std::time::Duration;

use sm2_proto::link::Counters;
use zerocopy::KnownLayout;

use self::untyped::UntypedPublisher;
use crate::handle::Handle;
use crate::handle::methods::interface_methods;
use crate::loan::Loan;
use crate::plain::size_for;
use crate::published::Published;
use crate::{Message, Plain, PublishError, StoreError, WaitError};

mod builder;
mod many;
pub(crate) mod untyped;

pub use self::builder::PublisherBuilder;

/// Sends messages of type `T` to all subscribers of a topic.
///
/// Each message is stored once, however many subscribers there are. A subscriber that is slow,
/// or stopped, or dead costs the others nothing: what happens to messages that it does not take
/// is its own link's affair, and is counted there ([`links`](Self::links)).
///
/// - *keep-last*, the default: up to `depth` messages wait for each subscriber, and one more
///   displaces the oldest (SM2-QOS-001).
/// - *reliable*, for subscribers that demand it: see [`PublisherBuilder::reliable`].
/// - *latched*: see [`PublisherBuilder::latched`].
///
/// Its descriptor ([`AsFd`](std::os::fd::AsFd)) is readable when a reliable subscriber that had no room may have some,
/// or when anything else happened to its links.
///
/// Dropping it withdraws it. What was sent can still be received; what still waited for a
/// subscriber is lost, so [`flush`](Self::flush) first if that matters.
#[derive(Debug)]
pub struct Publisher<T: Message + ?Sized> {
    pub(crate) core: UntypedPublisher,
    sends: PhantomData<fn(&T)>,
}

interface_methods! {
    Publisher<T>,
    topic: "The name of its topic.",
    "subscribers": wait_for_subscribers, wait_for_subscribers_timeout,
}

impl<T: Message + ?Sized> Publisher<T> {
    const fn handle(&self) -> &Handle {
        &self.core.handle
    }

    /// Sends one message to all subscribers whose links are open.
    ///
    /// Waits only if a reliable subscriber has no room, and then for at most the
    /// [`publish_timeout`](PublisherBuilder::publish_timeout). A subscriber that misses the message
    /// is not an error, because all others have it: see [`Published`].
    ///
    /// # Errors
    ///
    /// See [`PublishError`].
    pub fn publish(&self, message: &T) -> Result<Published, PublishError> {
        let bytes = message.bytes().map_err(StoreError::Encode)?;
        self.core.publish_bytes(bytes)
    }

    /// Waits, without a time limit, until every reliable subscriber has given back all messages,
    /// and every other subscriber was sent as many as its window admits.
    ///
    /// # Errors
    ///
    /// [`WaitError::Io`].
    pub fn flush(&self) -> Result<(), WaitError> {
        self.core.flush(None).map(drop)
    }

    /// As [`flush`](Self::flush), for at most `timeout`. Returns whether everything was flushed.
    ///
    /// # Errors
    ///
    /// [`WaitError::Io`].
    pub fn flush_timeout(&self, timeout: Duration) -> Result<bool, WaitError> {
        self.core.flush(Some(timeout))
    }

    /// What became of all messages on all links that ever were:
    /// `offered = delivered + overwritten + discarded + deadline + closed + in_flight` (SM2-QOS-004).
    pub fn counters(&self) -> Counters {
        self.core.handle.with(|interface, _| interface.counters())
    }

    /// The size of the shared memory that its messages have, in bytes. Pages that were
    /// never written take no memory.
    pub fn pool_bytes(&self) -> u64 {
        (self.core.handle).with(|interface, _| interface.outbox.pool_bytes())
    }
}

impl<T: Plain> Publisher<T> {
    /// Memory for one message, to be written in place: no copy is made of it.
    ///
    /// # Errors
    ///
    /// See [`StoreError`].
    pub fn loan(&self) -> Result<Loan<'_, T>, StoreError> {
        Loan::new(&self.core, size_of::<T>())
    }
}

impl<T: Plain + ?Sized + KnownLayout<PointerMetadata = usize>> Publisher<T> {
    /// Memory for one message of which `count` elements are at the end: a slice of so many,
    /// or a structure that ends with such a slice. It is written in place.
    ///
    /// # Errors
    ///
    /// See [`StoreError`].
    pub fn loan_slice(&self, count: usize) -> Result<Loan<'_, T>, StoreError> {
        let len = size_for::<T>(count).ok_or(StoreError::TooLong { len: u64::MAX })?;
        Loan::new(&self.core, len)
    }
}
