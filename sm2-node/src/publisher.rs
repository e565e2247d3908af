//! Sending the messages of a topic.

use std::marker::PhantomData;
use std::os::fd::{AsFd, BorrowedFd};
use std::time::Duration;

use sm2_proto::domain::Near;
use sm2_proto::limits::INLINE_MAX;
use sm2_proto::link::Counters;
use sm2_proto::{Kind, Name, TypeId};
use zerocopy::KnownLayout;

use self::untyped::UntypedPublisher;
use crate::driver::LinkStatus;
use crate::error::QueryError;
use crate::loan::Loan;
use crate::plain::size_for;
use crate::published::Published;
use crate::{DeclareError, Message, Plain, PublishError, StoreError, WaitError};

mod builder;
mod many;
pub(crate) mod untyped;

pub use self::builder::PublisherBuilder;

/// Payloads up to this length travel in the datagram itself, unless a builder says otherwise.
pub(crate) const INLINE_DEFAULT: usize = 4_096;

/// What a builder was told, as far as a datagram has room for it.
pub(crate) const fn inline_limit(bytes: usize) -> usize {
    if bytes > INLINE_MAX {
        INLINE_MAX
    } else {
        bytes
    }
}

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
/// Dropping it withdraws it. What was sent can still be received; what still waited for a
/// subscriber is lost, so [`flush`](Self::flush) first if that matters.
#[derive(Debug)]
pub struct Publisher<T: Message + ?Sized> {
    pub(crate) core: UntypedPublisher,
    sends: PhantomData<fn(&T)>,
}

impl<T: Message + ?Sized> Publisher<T> {
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

    /// How many subscribers matched when it was declared (SM2-IFC-002).
    #[must_use]
    pub const fn matched(&self) -> usize {
        self.core.handle.matched()
    }

    /// Waits until at least `count` subscribers are linked, without a time limit.
    ///
    /// # Errors
    ///
    /// [`WaitError::Io`].
    pub fn wait_for_subscribers(&self, count: usize) -> Result<(), WaitError> {
        self.core.handle.wait_open(count, None)
    }

    /// Waits until at least `count` subscribers are linked, for at most `timeout`.
    ///
    /// # Errors
    ///
    /// See [`WaitError`].
    pub fn wait_for_subscribers_timeout(
        &self,
        count: usize,
        timeout: Duration,
    ) -> Result<(), WaitError> {
        self.core.handle.wait_open(count, Some(timeout))
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

    /// Whether the Manager has it: not while there is none, and not if another one took over
    /// that refused it, which is logged with the reason (SM2-RES-009). Links that are open go on.
    #[must_use]
    pub fn is_registered(&self) -> bool {
        self.core.handle.is_registered()
    }

    /// Of the interfaces that are there, those that come closest to a subscriber of this publisher, and why
    /// each of them does not match: for one that stays without links.
    ///
    /// # Errors
    ///
    /// See [`QueryError`].
    pub fn why(&self) -> Result<Vec<Near>, QueryError> {
        self.core.handle.why()
    }

    /// Its links: those that ended (the last 64 of them), then those that are there.
    pub fn links(&self) -> Vec<LinkStatus> {
        self.core.handle.links()
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

/// Readable when a subscriber that was without room may have some, or anything else happened
/// that is worth a look at the publisher's links.
impl<T: Message + ?Sized> AsFd for Publisher<T> {
    fn as_fd(&self) -> BorrowedFd<'_> {
        self.core.handle.descriptor()
    }
}

/// A type and its text, for the Manager. Bytes have none, whatever type they are said to be.
pub(crate) fn schema_of<T: Message + ?Sized>() -> (TypeId, Option<String>) {
    (T::type_id(), T::schema())
}

/// A topic's or service's name, as a person wrote it.
pub(crate) fn checked_name(kind: Kind, name: String) -> Result<Name, DeclareError> {
    Name::typed(&name).map_err(|reason| DeclareError::Name { kind, name, reason })
}
