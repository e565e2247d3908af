//! Sending the messages of a topic.

use std::borrow::Cow;
use std::io;
use std::marker::PhantomData;
use std::os::fd::{AsFd, BorrowedFd, OwnedFd};
use std::sync::{Mutex, PoisonError};
use std::time::Duration;

use sm2_io::Blank;
use sm2_proto::limits::INLINE_MAX;
use sm2_proto::link::Counters;
use sm2_proto::{Instant, Kind, Name, TypeId};
use zerocopy::KnownLayout;

use crate::driver::LinkStatus;
use crate::driver::{Forms, Label, Offered, Topic};
use crate::error::QueryError;
use crate::handle::{Handle, until};
use crate::loan::Loan;
use crate::plain::size_for;
use crate::stock::{self, Stock};
use crate::{DeclareError, Message, Plain, PublishError, StoreError, WaitError};
use sm2_proto::domain::Near;

mod builder;
mod many;

pub use self::builder::PublisherBuilder;

/// Payloads up to this length travel in the datagram itself, unless a builder says otherwise.
pub(crate) const INLINE_DEFAULT: usize = 4_096;

/// Messages up to this length are copied while the node is locked: that is quicker than to lock
/// it again.
const SHORT: usize = 16 << 10;

/// How long a publication that has to wait spins before it sleeps: about as long as it takes to
/// fall asleep and to wake up.
const SPIN: Duration = Duration::from_micros(20);

/// In pauses of the processor, how long it leaves the memory alone meanwhile.
const PAUSES: u32 = 64;

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
    pub(crate) core: Core,
    sends: PhantomData<fn(&T)>,
}

/// What does not depend on the type.
#[derive(Debug)]
pub(crate) struct Core {
    pub(crate) handle: Handle,
    /// Held while a message is published: on each link, publications come in their order.
    turn: Mutex<()>,
    pub(crate) inline_max: usize,
    /// See [`PublisherBuilder::publish_timeout`].
    publish_timeout: Duration,
    /// Memory for the next sealed message.
    stock: Mutex<Stock>,
}

/// What became of one publication.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Published {
    /// How many links took it.
    pub links: usize,
    /// How many reliable links had no room for it until the deadline. They go
    /// without this message, and are not waited for again until they give something back
    /// (SM2-QOS-002).
    pub missed: usize,
}

impl Published {
    /// That no reliable subscriber missed the message.
    ///
    /// # Errors
    ///
    /// [`PublishError::DeadlineExceeded`] if one did.
    pub const fn complete(self) -> Result<Self, PublishError> {
        match self {
            Self { missed: 0, .. } => Ok(self),
            Self { links, missed } => Err(PublishError::DeadlineExceeded { links, missed }),
        }
    }
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

impl Core {
    fn flush(&self, timeout: Option<Duration>) -> Result<bool, WaitError> {
        let Handle { shared, id, .. } = &self.handle;
        let flushed = shared.wait(Topic::Interface(*id), until(timeout), |inner| {
            let flushed = inner.with(*id, &shared.epoll, |interface, _| {
                interface.links().all(|link| link.is_flushed())
            });
            (flushed == Some(true)).then_some(())
        });
        Ok(flushed.map_err(WaitError::Io)?.is_some())
    }

    fn publish_bytes(&self, bytes: Cow<'_, [u8]>) -> Result<Published, PublishError> {
        let _turn = self.turn.lock().unwrap_or_else(PoisonError::into_inner);
        let mut published = Published::default();
        if self.publish_shorts(std::slice::from_ref(&bytes), &mut published) == 1 {
            return Ok(published);
        }
        let publication = self.start(bytes)?;
        self.wait_for_room(publication)
    }

    /// Sends a message to all who have room now. It has to be [finished](Self::finish).
    pub(crate) fn start(&self, bytes: Cow<'_, [u8]>) -> Result<Publication, PublishError> {
        let needs = self.handle.with_due(|interface, _| interface.needs());
        let len = bytes.len() as u64;
        let ready = |len| self.ready(|stock, now| stock.for_copy(len, now));
        let forms = (self.handle).store_with(bytes, self.inline_max, needs, ready)?;
        Ok(self.offer(forms, len))
    }

    /// What the stock has.
    pub(crate) fn ready(
        &self,
        take: impl FnOnce(&mut Stock, Instant) -> Option<Blank>,
    ) -> Option<Blank> {
        // While another thread fills it, it is as good as empty.
        let mut stock = self.stock.try_lock().ok()?;
        take(&mut stock, sm2_io::clock::now())
    }

    /// A sealed copy.
    pub(crate) fn seal(&self, bytes: &[u8]) -> io::Result<OwnedFd> {
        let ready = self.ready(|stock, now| stock.for_copy(bytes.len(), now));
        stock::seal(ready, bytes)
    }

    /// Publishes what a loan holds. Its caller drove the node.
    pub(crate) fn publish_forms(&self, forms: Forms, len: u64) -> Result<Published, PublishError> {
        let _turn = self.turn.lock().unwrap_or_else(PoisonError::into_inner);
        let publication = self.offer(forms, len);
        self.wait_for_room(publication)
    }

    fn offer(&self, forms: Forms, len: u64) -> Publication {
        let now = sm2_io::clock::now();
        let label = Label {
            id: 0,
            time: now,
            len,
        };
        let offered = self.handle.with_idle(|interface, tools| {
            let offered = interface.publish(forms, label, tools);
            interface.rest(now, tools);
            offered
        });
        Publication {
            offered,
            deadline: now.after(self.publish_timeout),
        }
    }

    /// A subscriber that takes messages just now makes room sooner than this thread would be
    /// awake again.
    fn spin_for_room(&self, publication: &mut Publication) {
        let until = sm2_io::clock::now().after(SPIN);
        while !publication.is_done() && sm2_io::clock::now() < until {
            // Each look costs the subscriber, which writes to the same memory.
            for _ in 0..PAUSES {
                std::hint::spin_loop();
            }
            self.handle.with_idle(|interface, tools| {
                interface.publish_more(&mut publication.offered, tools)
            });
        }
    }

    //= SM2-QOS-002
    fn wait_for_room(&self, mut publication: Publication) -> Result<Published, PublishError> {
        let Handle { shared, id, .. } = &self.handle;
        let mut waited = Ok(None);
        self.spin_for_room(&mut publication);
        if !publication.is_done() {
            let deadline = Some(publication.deadline);
            waited = shared.wait(Topic::Interface(*id), deadline, |inner| {
                let done = inner.with(*id, &shared.epoll, |interface, tools| {
                    interface.publish_more(&mut publication.offered, tools)
                });
                (done == Some(true)).then_some(())
            });
        }
        let published = self.finish(publication);
        waited.map_err(PublishError::Io)?;
        Ok(published)
    }

    /// Drives the node, and sends to those who have room by now; whether nobody is left to wait
    /// for. If somebody is, the descriptor is silent until something happens.
    #[cfg(feature = "tokio")]
    pub(crate) fn go_on(&self, publication: &mut Publication) -> bool {
        let Handle { shared, id, .. } = &self.handle;
        let done = self.handle.look(&mut shared.driven(), |inner| {
            let done = inner.with(*id, &shared.epoll, |interface, tools| {
                interface.publish_more(&mut publication.offered, tools)
            });
            (done == Some(true)).then_some(())
        });
        done.is_some()
    }

    /// The waiting is over: who has no room goes without this message.
    pub(crate) fn finish(&self, publication: Publication) -> Published {
        let published = self
            .handle
            .with_idle(|interface, tools| interface.finish(publication.offered, tools));
        // Now that nobody waits for this message.
        if let Ok(mut stock) = self.stock.try_lock() {
            stock.refill(sm2_io::clock::now);
        }
        published
    }
}

/// A message that was published, but not sent to all links yet.
#[derive(Debug)]
pub(crate) struct Publication {
    offered: Offered,
    /// When those that have no room are not waited for any more.
    deadline: Instant,
}

impl Publication {
    /// Whether nobody is waited for.
    pub(crate) fn is_done(&self) -> bool {
        self.offered.waiting.is_empty()
    }

    /// Time until the deadline.
    #[cfg(feature = "tokio")]
    pub(crate) fn remaining(&self) -> Duration {
        self.deadline.since(sm2_io::clock::now())
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
