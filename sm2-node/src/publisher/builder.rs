//! The options of a publisher.

use std::marker::PhantomData;
use std::sync::Arc;
use std::time::Duration;

use sm2_proto::{Contract, Kind, Name, OfferedQos, Period, TypeId, WaitBudget};

use super::Publisher;
use super::untyped::UntypedPublisher;
use crate::driver::{NoSlot, PoolLimit, Reservation, Reserved, SharedNode};
use crate::handle::declaration::{Declaration, inline_max_setter, schema_of, sealed_setter};
use crate::pool::IDLE_DEFAULT;
use crate::{DeclareError, Message};

/// The default of [`PublisherBuilder::publish_timeout`], as in the reliability policy of DDS.
const PUBLISH_TIMEOUT_DEFAULT: Duration = Duration::from_millis(100);

/// The quality of service of a publisher, and its memory.
#[derive(Debug)]
#[must_use = "a builder does nothing until declare is called"]
pub struct PublisherBuilder<T: Message + ?Sized> {
    declaration: Declaration,
    data: Option<TypeId>,
    offer: OfferedQos,
    publish_timeout: Duration,
    wait_share_percent: u8,
    memory: Memory,
    sends: PhantomData<fn(&T)>,
}

/// The options for the memory of messages.
#[derive(Debug)]
struct Memory {
    limit_bytes: Option<u64>,
    idle: Duration,
    max_len: Option<usize>,
    slots: Option<u32>,
    how: Reservation,
}

impl<T: Message + ?Sized> PublisherBuilder<T> {
    pub(crate) fn new(shared: &Arc<SharedNode>, topic: &str) -> Self {
        Self {
            declaration: Declaration::new(shared, topic),
            data: None,
            offer: OfferedQos::new(8),
            publish_timeout: PUBLISH_TIMEOUT_DEFAULT,
            wait_share_percent: WaitBudget::SHARE_DEFAULT_PERCENT,
            memory: Memory {
                limit_bytes: None,
                idle: IDLE_DEFAULT,
                max_len: None,
                slots: None,
                how: Reservation::default(),
            },
            sends: PhantomData,
        }
    }

    /// Sets how many messages wait for each subscriber that does not take them yet: 1 to 1,024; 8 by default.
    /// On the ring lane, messages wait in the subscriber's ring, so the subscriber's
    /// [depth](crate::SubscriberBuilder::depth) applies instead.
    pub const fn depth(mut self, messages: u16) -> Self {
        self.offer.depth = messages;
        self
    }

    /// Offers reliable delivery to subscribers that request it; `false` by default.
    ///
    /// For a reliable subscriber, no message displaces another one. If such a subscriber has no room, the
    /// publisher waits for at most the [`publish_timeout`](Self::publish_timeout), and then skips this
    /// subscriber (SM2-QOS-002). Subscribers that have room get the message before the publisher waits, but the next
    /// message reaches them later. So that no subscriber can slow down the others for long, two rules limit the wait:
    ///
    /// - A subscriber that missed a message *owes*: no publication waits for it until it has released all messages that
    ///   were in flight to it then (SM2-QOS-003). It still gets each message that it has room for.
    /// - All waits of the publisher together take at most one `publish_timeout`, and the
    ///   [`wait_share_percent`](Self::wait_share_percent) of the time (SM2-QOS-004).
    ///
    /// Each message that a subscriber misses by these rules counts as
    /// [`no_room`](sm2_proto::link::Counters::no_room) here and in [`Published::missed`](crate::Published::missed).
    /// The subscriber learns of the gap with the next message: [`Sample::lost`](crate::Sample::lost).
    ///
    /// A transfer that must lose nothing to a subscriber that is slower for long sets `wait_share_percent(100)` and a
    /// long `publish_timeout`, or calls [`wait_for_room`](Publisher::wait_for_room) before each message. The publisher
    /// is then as slow as its slowest reliable subscriber, and so is the topic for all others.
    pub const fn reliable(mut self, reliable: bool) -> Self {
        self.offer.reliable = reliable;
        self
    }

    /// Sets how long [`publish`](Publisher::publish) waits for reliable subscribers that have no room; 100 ms
    /// by default. With `Duration::ZERO` it never waits.
    pub const fn publish_timeout(mut self, timeout: Duration) -> Self {
        self.publish_timeout = timeout;
        self
    }

    /// Limits the time that publications wait for reliable subscribers, in per cent of the time; 1 by default. Values
    /// above 100 count as 100.
    ///
    /// In any period, all waits of this publisher together take at most this share of the period, and once the longest
    /// timeout of a publication (SM2-QOS-004). If nothing is left, a publication does not wait: a reliable subscriber
    /// without room misses the message. With the default, subscribers that keep up get at least 0.97 of the messages
    /// that the program publishes in 8 s, whatever reliable subscribers do. With 0 the publisher waits for one timeout
    /// in its life; with 100, each publication can wait for its whole timeout.
    ///
    /// [`Publisher::wait_for_room`] and [`Publisher::try_publish`] are not limited: the program itself decides to wait.
    pub const fn wait_share_percent(mut self, percent: u8) -> Self {
        self.wait_share_percent = percent;
        self
    }

    /// Keeps the last `messages`, and sends them to every new subscriber before any other message
    /// (SM2-QOS-005): 0 to 1,024; 0 by default.
    pub const fn latched(mut self, messages: u16) -> Self {
        self.offer.latched = messages;
        self
    }

    /// Promises a message at least once in each `period`; no promise by default. Only such a publisher matches a
    /// subscriber that demands a [deadline](crate::SubscriberBuilder::deadline), which must not be shorter than
    /// `period`.
    ///
    /// The first period begins when the publisher is declared. Each period that passes without a message counts as
    /// [missed](Publisher::missed_deadlines) and is an [event](crate::Event::DeadlineMissed) (SM2-QOS-009).
    pub const fn deadline(mut self, period: Duration) -> Self {
        self.offer.deadline = Period::new(period);
        self
    }

    /// Promises a sign of life of the program at least once in each `lease`: a message, or
    /// [`assert_liveliness`](Publisher::assert_liveliness). By default a publisher is alive as long as its links are
    /// open, which the kernel watches. A subscriber that demands a
    /// [liveliness](crate::SubscriberBuilder::liveliness) matches only publishers with a lease that is not longer than
    /// the lease of the subscriber.
    ///
    /// The first lease begins when the publisher is declared. When a lease passes without a sign of life, this side and
    /// each subscriber that demands a liveliness get an [event](crate::Event::LivelinessLost).
    /// [Another one](crate::Event::LivelinessRegained) tells them that the publisher is alive again (SM2-QOS-011).
    pub const fn liveliness(mut self, lease: Duration) -> Self {
        self.offer.lease = Period::new(lease);
        self
    }

    /// Sets the age that ends the delivery of messages; none by default. A message that is older is neither
    /// sent nor handed out, latched or not, and counts as
    /// [`expired`](sm2_proto::link::Counters::expired) on both sides (SM2-QOS-010).
    pub const fn lifespan(mut self, age: Duration) -> Self {
        self.offer.lifespan = Period::new(age);
        self
    }

    sealed_setter!(
        offer,
        "Seals every message: no process, not even this one, can change it after it is sent.

A message longer than [`inline_max`](Self::inline_max) gets a new memory file; a shorter one is copied into the
datagram. A subscriber, and the Manager (`--seal-all`), can require it as well. While messages follow each
other closely, `publish` also prepares one file of similar length for the next message. It goes back to the
system after [`keep_idle`](Self::keep_idle)."
    );
    inline_max_setter!("Messages");

    /// Sets how much shared memory messages may use, in bytes, in addition to the memory that
    /// [`max_len`](Self::max_len) reserves: slots, and the files of sealed messages. By default
    /// [`POOL_LIMIT_BYTES`](crate::POOL_LIMIT_BYTES), or memory for
    /// [`POOL_LIMIT_MESSAGES`](crate::POOL_LIMIT_MESSAGES) messages of the longest length so far and
    /// the [latched](Self::latched) ones, whichever is more.
    ///
    /// A subscriber that keeps its samples keeps their memory. When unreleased messages fill half of the limit,
    /// the publisher suspends the subscriber with the oldest one: it gets no message until it releases one
    /// (SM2-QOS-007), and the messages that it misses count as
    /// [`pool_limit`](sm2_proto::link::Counters::pool_limit). Its samples stay valid, and their memory no longer
    /// counts as available: the others share half of the rest in the same way. The second half is for the
    /// subscribers that release what they get. A limit of 0 leaves only the reserved memory, and one
    /// subscriber can use all of it up.
    ///
    /// For a reliable subscriber the publisher first waits, as it does for room.
    pub const fn pool_limit(mut self, bytes: u64) -> Self {
        self.memory.limit_bytes = Some(bytes);
        self
    }

    /// Sets how long unused shared memory is kept; 5 s by default. After that, the next call of the publisher
    /// gives it back to the system (no thread does this). `Duration::MAX` keeps it for as long as the
    /// publisher exists.
    ///
    /// Memory is given back in whole segments, and only if no subscriber holds a sample in the segment. The
    /// publisher uses its oldest memory first, so that memory for a burst becomes unused soon.
    pub const fn keep_idle(mut self, idle: Duration) -> Self {
        self.memory.idle = idle;
        self
    }

    /// Reserves memory for [`slots`](Self::slots) messages of up to `bytes` when the publisher is declared,
    /// and keeps it for as long as the publisher exists. Without [`prefault`](Self::prefault) or
    /// [`mlock`](Self::mlock), pages occupy memory only when they are written. Longer messages, or more
    /// messages at a time, are allowed: they get additional memory, within [`pool_limit`](Self::pool_limit).
    /// A limit of 0 allows none.
    pub const fn max_len(mut self, bytes: usize) -> Self {
        self.memory.max_len = Some(bytes);
        self
    }

    /// Sets for how many messages [`max_len`](Self::max_len) reserves memory: those that subscribers hold or
    /// have not taken yet, and the one that is being written. `depth + latched + 4` by default.
    pub const fn slots(mut self, messages: u32) -> Self {
        self.memory.slots = Some(messages);
        self
    }

    /// Makes all reserved memory present when the publisher is declared, in huge pages if possible. From then
    /// on, publishing and loaning messages of up to `max_len` neither allocates memory from the system nor
    /// causes page faults. Short messages use this memory too, whatever [`inline_max`](Self::inline_max) is.
    pub const fn prefault(mut self, prefault: bool) -> Self {
        self.memory.how.prefault = prefault;
        self
    }

    /// Locks the reserved memory, so that it is never swapped out. This needs a sufficient `RLIMIT_MEMLOCK`.
    pub const fn mlock(mut self, lock: bool) -> Self {
        self.memory.how.lock = lock;
        self
    }

    /// Declares the publisher, and waits for the Manager's answer.
    ///
    /// # Errors
    ///
    /// See [`DeclareError`].
    pub fn declare(self) -> Result<Publisher<T>, DeclareError> {
        let topic = self.declaration.checked_name(Kind::Publisher)?;
        let reserved = self.memory.reserve(&topic, &self.offer)?;
        let latched = self.offer.latched;
        let contract = Contract::Publisher {
            topic,
            data: self.data.unwrap_or_else(T::type_id),
            offer: self.offer,
        };
        let Memory {
            limit_bytes,
            idle,
            how,
            ..
        } = self.memory;
        let limit = match limit_bytes {
            Some(bytes) => PoolLimit::bytes(bytes),
            None => PoolLimit::default_with(latched),
        };
        let schemas = [schema_of::<T>()];
        let mut handle = self.declaration.declare(contract, limit, schemas)?;
        handle.keep(idle, reserved);
        // Datagrams would need memory that is not reserved.
        if how.prefault {
            handle.inline_max = 0;
        }
        Ok(Publisher {
            core: UntypedPublisher::new(
                handle,
                self.publish_timeout,
                self.wait_share_percent,
                idle,
            ),
            sends: PhantomData,
        })
    }
}

impl PublisherBuilder<[u8]> {
    /// Sets the type of the messages, which are sent as bytes: for tools that handle types unknown at compile
    /// time.
    pub fn type_id(mut self, data: TypeId) -> Self {
        self.data = Some(data);
        self
    }
}

impl Memory {
    /// Reserves the memory that the options ask for.
    fn reserve(&self, topic: &Name, offer: &OfferedQos) -> Result<Option<Reserved>, DeclareError> {
        let name = || topic.clone();
        let Some(max_len) = self.max_len else {
            return match (self.slots, self.how) {
                (None, how) if how == Reservation::default() => Ok(None),
                _ => Err(DeclareError::NoMaxLen { name: name() }),
            };
        };
        if offer.sealed {
            return Err(DeclareError::ReservedSealed { name: name() });
        }
        let usual = u32::from(offer.depth) + u32::from(offer.latched) + 4;
        let slots = self.slots.unwrap_or(usual).max(1);
        let reserved = Reserved::new(max_len as u64, slots, self.how);
        reserved.map(Some).map_err(|error| match error {
            NoSlot::Full => DeclareError::ReserveTooMuch {
                name: name(),
                max_len,
                slots,
            },
            NoSlot::Io(source) => DeclareError::Reserve {
                name: name(),
                max_len,
                slots,
                source,
            },
            NoSlot::Lock(source) => DeclareError::Lock {
                name: name(),
                max_len,
                slots,
                // If the limit is unknown, there is none.
                limit_bytes: sm2_io::memfd::locked_bytes_max().unwrap_or(u64::MAX),
                source,
            },
        })
    }
}
