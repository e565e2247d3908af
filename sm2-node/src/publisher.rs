//! Sending the messages of a topic.

use std::marker::PhantomData;
use std::time::Duration;

use sm2_proto::link::Counters;
use zerocopy::KnownLayout;

use self::untyped::UntypedPublisher;
use crate::handle::Handle;
use crate::handle::methods::interface_methods;
use crate::loan::Loan;
use crate::outgoing::Outgoing;
use crate::plain::size_for;
use crate::published::Published;
use crate::{Message, Plain, PublishError, StoreError, WaitError};

mod builder;
mod many;
pub(crate) mod untyped;

pub use self::builder::PublisherBuilder;

/// Sends messages of type `T` to all subscribers of a topic.
///
/// Each message is stored once, for any number of subscribers, or copied to each of them if it is
/// [short](crate#how-a-message-travels). A best-effort subscriber that is slow, stopped
/// or dead does not affect the others: its own link drops the messages that it does not take, and counts them
/// ([`links`](Self::links)). A reliable one can delay [`publish`](Self::publish).
///
/// - *keep-last*, the default: up to `depth` messages wait for each subscriber; one more displaces the oldest
///   (SM2-QOS-001).
/// - *reliable*, for subscribers that request it: see [`PublisherBuilder::reliable`].
/// - *latched*: see [`PublisherBuilder::latched`].
///
/// The publisher's descriptor ([`AsFd`](std::os::fd::AsFd)) is readable when a reliable subscriber may have
/// room again, or when another event happened on its links.
///
/// Dropping the publisher withdraws it. Subscribers can still take the messages that were sent to them. A
/// message that still waits in the publisher is lost: call [`flush`](Self::flush) first to send it.
///
/// ```
/// # fn main() -> Result<(), Box<dyn std::error::Error>> {
/// # let domain = sm2_node::testing::TestDomain::new()?;
/// # let node = domain.node("lidar")?;
/// # let subscriber = domain.node("map")?.subscriber_builder::<[f32]>("scan").reliable(true).declare()?;
/// use std::time::Duration;
///
/// let scans = node.publisher_builder::<[f32]>("scan")
///     .reliable(true)                             // for subscribers that request it
///     .publish_timeout(Duration::from_millis(5))
///     .declare()?;
/// scans.wait_for_subscribers(1)?;
/// let published = scans.publish(&[1.0, 2.5])?;
/// assert_eq!(published.links, 1);
/// # Ok(())
/// # }
/// ```
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
    pub(crate) const fn handle(&self) -> &Handle {
        &self.core.handle
    }

    /// Sends one message to all subscribers whose links are open.
    ///
    /// Waits only if a reliable subscriber has no room and does not owe, and then for at most the
    /// [`publish_timeout`](PublisherBuilder::publish_timeout) and within the
    /// [share](PublisherBuilder::wait_share_percent) of the publisher: see [`PublisherBuilder::reliable`]. A
    /// subscriber that misses the message is not an error, because all others have it: see [`Published`].
    ///
    /// # Errors
    ///
    /// See [`PublishError`].
    pub fn publish(&self, message: &T) -> Result<Published, PublishError> {
        self.publish_timeout(message, self.core.publish_timeout)
    }

    /// As [`publish`](Self::publish), with a timeout for this message.
    ///
    /// All subscribers that have room get the message first. Then the call waits for all reliable ones without room at
    /// the same time. A subscriber without room at the end of the timeout misses the message
    /// ([`Published::missed`]), and no later publication waits for it until it has released all messages that were in
    /// flight to it (SM2-QOS-003). With `Duration::ZERO` the call waits for no subscriber.
    ///
    /// # Errors
    ///
    /// See [`PublishError`].
    pub fn publish_timeout(
        &self,
        message: &T,
        timeout: Duration,
    ) -> Result<Published, PublishError> {
        let message = Outgoing::new(message).map_err(StoreError::Encode)?;
        self.core.publish(message, timeout)
    }

    /// Sends one message to all subscribers, or to none of them.
    ///
    /// Returns `None` if [`publish`](Self::publish) would wait: a reliable subscriber has no room. No subscriber gets
    /// the message then, and nothing is counted. A reliable subscriber that missed a message and owes (SM2-QOS-003) is
    /// not considered: without room, it misses this message, too.
    ///
    /// # Errors
    ///
    /// See [`PublishError`].
    pub fn try_publish(&self, message: &T) -> Result<Option<Published>, PublishError> {
        let message = Outgoing::new(message).map_err(StoreError::Encode)?;
        self.core.try_publish(message)
    }

    /// Waits, without a time limit, until every reliable subscriber has room for one message. The next
    /// [`publish`](Self::publish) does not wait, and the next [`try_publish`](Self::try_publish) sends the message,
    /// unless another thread publishes or a subscriber joins in between.
    ///
    /// Does not wait for subscribers that are not reliable, nor for a reliable one that missed a message and owes
    /// (SM2-QOS-003). A [`Shutdown`](crate::Shutdown) ends the wait.
    ///
    /// # Errors
    ///
    /// [`WaitError::Shutdown`], [`WaitError::Io`].
    pub fn wait_for_room(&self) -> Result<(), WaitError> {
        self.core.wait_for_room(None).map(drop)
    }

    /// As [`wait_for_room`](Self::wait_for_room), for at most `timeout`. Returns whether there is room.
    ///
    /// # Errors
    ///
    /// As [`wait_for_room`](Self::wait_for_room).
    pub fn wait_for_room_timeout(&self, timeout: Duration) -> Result<bool, WaitError> {
        self.core.wait_for_room(Some(timeout))
    }

    /// Waits, without a time limit, until no message waits in the publisher. A reliable subscriber has then
    /// released every message, and any other subscriber was sent every message that keep-last left. A message
    /// [in a cell](crate#how-a-message-travels) is released when it is taken.
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

    /// Returns the [fates](sm2_proto::link::Fate) of all messages, summed over all current and past links: `offered` is
    /// the sum of all fates and `in_flight` (SM2-QOS-006).
    pub fn counters(&self) -> Counters {
        self.core
            .handle
            .with_driven(|interface, _| interface.links.counters())
    }

    /// Returns how long publications of this publisher have waited for reliable subscribers, in sum: see
    /// [`wait_share_percent`](PublisherBuilder::wait_share_percent).
    pub fn waited(&self) -> Duration {
        self.core.waited()
    }

    /// Returns how many messages were published while no subscriber was linked.
    pub fn unheard(&self) -> u64 {
        (self.core.handle).with_driven(|interface, _| interface.reports.unheard)
    }

    /// Returns how many periods of the [deadline](PublisherBuilder::deadline) have passed without a message.
    pub fn missed_deadlines(&self) -> u64 {
        (self.core.handle).with_driven(|interface, _| interface.qos_counts().missed_deadlines)
    }

    /// Asserts that the program is alive, as each publication does. A publisher that offers a
    /// [liveliness](PublisherBuilder::liveliness) and has nothing to publish calls this within its lease. At most
    /// once in a quarter of its lease, this costs a system call for each subscriber that demands a liveliness.
    pub fn assert_liveliness(&self) {
        self.core.handle.with_driven(|interface, context| {
            interface.assert_liveliness(sm2_io::clock::now(), context);
        });
    }

    /// Returns how often this publisher stopped being alive: its program showed no sign of life within the lease of its
    /// [liveliness](PublisherBuilder::liveliness).
    pub fn lost_liveliness(&self) -> u64 {
        (self.core.handle).with_driven(|interface, _| interface.qos_counts().lost_liveliness)
    }

    /// Returns the size of the shared memory for its messages, in bytes. Pages that were never written occupy
    /// no memory.
    pub fn pool_bytes(&self) -> u64 {
        (self.core.handle).with_driven(|interface, _| interface.outbox.pool_bytes())
    }
}

impl<T: Plain> Publisher<T> {
    /// Allocates memory for one message, to be written in place and sent without a copy.
    ///
    /// # Errors
    ///
    /// See [`StoreError`].
    pub fn loan(&self) -> Result<Loan<'_, T>, StoreError> {
        Loan::new(&self.core, size_of::<T>())
    }
}

impl<T: Plain + ?Sized + KnownLayout<PointerMetadata = usize>> Publisher<T> {
    /// Allocates memory for one message with `count` elements at its end: a slice, or a structure that ends
    /// in a slice. The message is written in place.
    ///
    /// # Errors
    ///
    /// See [`StoreError`].
    pub fn loan_slice(&self, count: usize) -> Result<Loan<'_, T>, StoreError> {
        let len = size_for::<T>(count).ok_or(StoreError::TooLong { len: u64::MAX })?;
        Loan::new(&self.core, len)
    }
}
