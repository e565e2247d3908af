//! The half of a publisher that does not depend on the type of its messages.

use std::borrow::Cow;
use std::io;
use std::os::fd::OwnedFd;
use std::sync::{Mutex, PoisonError};
use std::time::Duration;

use sm2_io::Blank;
use sm2_proto::Instant;

use crate::driver::{Forms, Label, Offered, Topic};
use crate::handle::{Handle, until};
use crate::published::Published;
use crate::stock::{self, Stock};
use crate::{PublishError, WaitError};

/// Messages up to this length are copied while the node is locked: that is quicker than to lock
/// it again.
pub(super) const SHORT: usize = 16 << 10;

/// How long a publication that has to wait spins before it sleeps: about as long as it takes to
/// fall asleep and to wake up.
const SPIN: Duration = Duration::from_micros(20);

/// In pauses of the processor, how long it leaves the memory alone meanwhile.
const PAUSES: u32 = 64;

/// What does not depend on the type.
#[derive(Debug)]
pub(crate) struct UntypedPublisher {
    pub(crate) handle: Handle,
    /// Held while a message is published: on each link, publications come in their order.
    pub(super) turn: Mutex<()>,
    /// See [`PublisherBuilder::publish_timeout`].
    publish_timeout: Duration,
    /// Memory for the next sealed message.
    stock: Mutex<Stock>,
}

impl UntypedPublisher {
    pub(super) const fn new(handle: Handle, publish_timeout: Duration, idle: Duration) -> Self {
        Self {
            handle,
            turn: Mutex::new(()),
            publish_timeout,
            stock: Mutex::new(Stock::new(idle)),
        }
    }

    pub(super) fn flush(&self, timeout: Option<Duration>) -> Result<bool, WaitError> {
        let Handle { shared, id, .. } = &self.handle;
        let flushed = shared.wait(Topic::Interface(*id), until(timeout), |inner| {
            let flushed = inner.with(*id, &shared.epoll, |interface, _| {
                interface.links().all(|link| link.is_flushed())
            });
            (flushed == Some(true)).then_some(())
        });
        Ok(flushed.map_err(WaitError::Io)?.is_some())
    }

    pub(super) fn publish_bytes(&self, bytes: Cow<'_, [u8]>) -> Result<Published, PublishError> {
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
        let forms = (self.handle).store_with(bytes, needs, ready)?;
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
    pub(super) fn wait_for_room(
        &self,
        mut publication: Publication,
    ) -> Result<Published, PublishError> {
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
