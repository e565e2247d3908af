//! What a publisher is to be like.

use std::marker::PhantomData;
use std::sync::Arc;
use std::time::Duration;

use sm2_proto::{Contract, Kind, Name, Offer, TypeId};

use super::Publisher;
use super::untyped::UntypedPublisher;
use crate::driver::{NoSlot, Reservation, Reserved, Shared};
use crate::handle::declaration::{Declaration, inline_max_setter, schema_of, sealed_setter};
use crate::pool::IDLE_DEFAULT;
use crate::{DeclareError, Message};

/// The default of [`PublisherBuilder::publish_timeout`], as in the reliability policy of DDS.
const PUBLISH_TIMEOUT_DEFAULT: Duration = Duration::from_millis(100);

/// A publisher's quality of service, and its memory.
#[derive(Debug)]
#[must_use = "a builder does nothing until declare is called"]
pub struct PublisherBuilder<T: Message + ?Sized> {
    declaration: Declaration,
    data: Option<TypeId>,
    offer: Offer,
    publish_timeout: Duration,
    memory: Memory,
    sends: PhantomData<fn(&T)>,
}

/// What messages are stored in.
#[derive(Debug)]
struct Memory {
    limit_bytes: u64,
    idle: Duration,
    max_len: Option<usize>,
    slots: Option<u32>,
    how: Reservation,
}

impl<T: Message + ?Sized> PublisherBuilder<T> {
    pub(crate) fn new(shared: &Arc<Shared>, topic: &str) -> Self {
        Self {
            declaration: Declaration::new(shared, topic),
            data: None,
            offer: Offer {
                depth: 8,
                reliable: false,
                latched: 0,
                sealed: false,
            },
            publish_timeout: PUBLISH_TIMEOUT_DEFAULT,
            memory: Memory {
                limit_bytes: u64::MAX,
                idle: IDLE_DEFAULT,
                max_len: None,
                slots: None,
                how: Reservation::default(),
            },
            sends: PhantomData,
        }
    }

    /// How many messages wait for each subscriber that has not taken those before:
    /// 1 to 1,024; 8 by default. On the ring lane, where messages wait in the subscriber's
    /// ring, its own [depth](crate::SubscriberBuilder::depth) says that instead.
    pub const fn depth(mut self, messages: u16) -> Self {
        self.offer.depth = messages;
        self
    }

    /// Offers reliable delivery, to subscribers that ask for it; `false` by default.
    ///
    /// No message displaces another one for a reliable subscriber. If such a subscriber has no
    /// room, the publisher waits for at most the [`publish_timeout`](Self::publish_timeout), and
    /// then drops the message for this subscriber alone (SM2-QOS-002). For other subscribers
    /// nothing changes.
    pub const fn reliable(mut self, reliable: bool) -> Self {
        self.offer.reliable = reliable;
        self
    }

    /// How long [`publish`](Publisher::publish) waits for reliable subscribers that have no room;
    /// 100 ms by default. `Duration::ZERO` never waits.
    pub const fn publish_timeout(mut self, timeout: Duration) -> Self {
        self.publish_timeout = timeout;
        self
    }

    /// The last `messages` are kept, and sent to every new subscriber before any other
    /// (SM2-QOS-003): 0 to 1,024; 0 by default.
    pub const fn latched(mut self, messages: u16) -> Self {
        self.offer.latched = messages;
        self
    }

    sealed_setter!(
        offer,
        "Every message is sealed: nobody, this program included, can change it after it is sent.

Costs new memory for each message. A subscriber, and the domain's policy, can require it as well.
While messages follow each other closely, the publisher prepares the memory of the next one after
each: one file of about its length. It goes back to the system after [`keep_idle`](Self::keep_idle)."
    );
    inline_max_setter!("Messages");

    /// How much shared memory messages may have, in bytes, not counting what
    /// [`max_len`](Self::max_len) reserves; without a limit by default, since
    /// the need is limited by depth and by what subscribers may hold.
    pub const fn pool_limit(mut self, bytes: u64) -> Self {
        self.memory.limit_bytes = bytes;
        self
    }

    /// How long shared memory is kept that no message used; 5 s by default. Then it goes back to the
    /// system, when the publisher is called next: it has no thread. `Duration::MAX` keeps it for
    /// as long as there is the publisher.
    ///
    /// Memory goes in whole segments, as it came, and not while a subscriber holds a sample in
    /// it. Publishing uses the oldest memory first, so that what a rush needed is free soon.
    pub const fn keep_idle(mut self, idle: Duration) -> Self {
        self.memory.idle = idle;
        self
    }

    /// Reserves memory for [`slots`](Self::slots) messages of up to this many bytes when the
    /// publisher is declared, to be kept for as long as it is there. Without
    /// [`prefault`](Self::prefault) or [`mlock`](Self::mlock) it is only set aside: pages take
    /// memory when they are written. Longer messages, and more at a time, are no error: they
    /// get memory as they come, within [`pool_limit`](Self::pool_limit), of which 0 allows none.
    pub const fn max_len(mut self, bytes: usize) -> Self {
        self.memory.max_len = Some(bytes);
        self
    }

    /// For how many messages [`max_len`](Self::max_len) reserves memory: those that any subscriber
    /// holds or has not taken yet, and the one that is written. `depth + latched + 4` by default.
    pub const fn slots(mut self, messages: u32) -> Self {
        self.memory.slots = Some(messages);
        self
    }

    /// All the memory that is reserved is present when the publisher is declared, in huge pages
    /// where there are some: from then on, publishing and loaning messages of up to `max_len`
    /// takes no memory from the system, and no page fault. Short messages go through it as
    /// well, whatever [`inline_max`](Self::inline_max) says.
    pub const fn prefault(mut self, prefault: bool) -> Self {
        self.memory.how.prefault = prefault;
        self
    }

    /// The memory that is reserved is never swapped out. This needs a limit (`RLIMIT_MEMLOCK`) that
    /// allows it.
    pub const fn mlock(mut self, lock: bool) -> Self {
        self.memory.how.lock = lock;
        self
    }

    /// Declares it, and waits for the Manager's word.
    ///
    /// # Errors
    ///
    /// See [`DeclareError`].
    pub fn declare(self) -> Result<Publisher<T>, DeclareError> {
        let topic = self.declaration.checked_name(Kind::Publisher)?;
        let reserved = self.memory.reserve(&topic, &self.offer)?;
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
        let schemas = [schema_of::<T>()];
        let mut handle = self.declaration.declare(contract, limit_bytes, schemas)?;
        handle.keep(idle, reserved);
        // A datagram's memory is not reserved.
        if how.prefault {
            handle.inline_max = 0;
        }
        Ok(Publisher {
            core: UntypedPublisher::new(handle, self.publish_timeout, idle),
            sends: PhantomData,
        })
    }
}

impl PublisherBuilder<[u8]> {
    /// The messages are of this type, whose encoding the program knows: for tools that
    /// handle types which they were not built with.
    pub fn type_id(mut self, data: TypeId) -> Self {
        self.data = Some(data);
        self
    }
}

impl Memory {
    /// What is to be there before any message.
    fn reserve(&self, topic: &Name, offer: &Offer) -> Result<Option<Reserved>, DeclareError> {
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
                // Where it is not known, there is none.
                limit_bytes: sm2_io::memfd::locked_bytes_max().unwrap_or(u64::MAX),
                source,
            },
        })
    }
}
