//! The half of a publisher that does not depend on the type of its messages.

use std::borrow::Cow;
use std::io;
use std::os::fd::OwnedFd;
use std::sync::{Mutex, PoisonError};
use std::time::Duration;

use sm2_io::Preallocated;
use sm2_proto::Instant;

use crate::driver::{Forms, Label, Offered, Topic};
use crate::handle::{Handle, until};
use crate::published::Published;
use crate::spare::{self, Fill, SpareMemory};
use crate::{PublishError, WaitError};

/// How long a publication that has to wait spins before it sleeps: about as long as it takes to
/// fall asleep and to wake up.
const SPIN: Duration = Duration::from_micros(20);

/// In pauses of the processor, how long it leaves the memory alone meanwhile.
const PAUSES: u32 = 64;

/// What does not depend on the type.
#[derive(Debug)]
pub(crate) struct UntypedPublisher {
    pub(crate) handle: Handle,
    /// Held while a message is published, so that each link carries messages in their order.
    pub(super) order: Mutex<()>,
    /// See [`PublisherBuilder::publish_timeout`].
    publish_timeout: Duration,
    /// Memory for the next sealed message.
    spare: Mutex<SpareMemory>,
}

impl UntypedPublisher {
    pub(super) const fn new(handle: Handle, publish_timeout: Duration, idle: Duration) -> Self {
        Self {
            handle,
            order: Mutex::new(()),
            publish_timeout,
            spare: Mutex::new(SpareMemory::new(idle)),
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
        let _order = self.order.lock().unwrap_or_else(PoisonError::into_inner);
        let mut published = Published::default();
        if self.publish_to_rings(std::slice::from_ref(&bytes), &mut published) == 1 {
            return Ok(published);
        }
        let publication = self.start(bytes)?;
        self.wait_for_room(publication)
    }

    /// Sends a message to all links that have room now.
    pub(crate) fn start(&self, bytes: Cow<'_, [u8]>) -> Result<Publication, PublishError> {
        let needs = self.handle.with_due(|interface, _| interface.needs());
        let len = bytes.len() as u64;
        let spare = |len| self.take_spare(len, Fill::Copy);
        let forms = (self.handle).store_with(bytes, needs, spare)?;
        Ok(self.offer(forms, len))
    }

    /// Takes memory for a sealed message of `len` bytes, if some is ready.
    pub(crate) fn take_spare(&self, len: usize, fill: Fill) -> Option<Preallocated> {
        // While another thread refills it, it is as good as empty.
        let mut spare = self.spare.try_lock().ok()?;
        spare.take(len, fill, sm2_io::clock::now())
    }

    /// A sealed copy.
    pub(crate) fn seal(&self, bytes: &[u8]) -> io::Result<OwnedFd> {
        spare::seal(self.take_spare(bytes.len(), Fill::Copy), bytes)
    }

    /// Publishes what a loan holds. Its caller drove the node.
    pub(crate) fn publish_forms(&self, forms: Forms, len: u64) -> Result<Published, PublishError> {
        let _order = self.order.lock().unwrap_or_else(PoisonError::into_inner);
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
        let publication = self.handle.with_idle(|interface, tools| {
            let offered = interface.publish(forms, label, tools);
            interface.rest(now, tools);
            if offered.waiting.is_empty() {
                return Publication::Done(interface.finish(offered, tools));
            }
            Publication::Waiting {
                offered,
                deadline: now.after(self.publish_timeout),
            }
        });
        if let Publication::Done(_) = publication {
            self.refill_spare();
        }
        publication
    }

    /// Waits actively for a moment: a subscriber that takes messages at this time makes room sooner
    /// than this thread could fall asleep and wake up. Returns whether all links have the message.
    fn spin_for_room(&self, offered: &mut Offered) -> bool {
        let until = sm2_io::clock::now().after(SPIN);
        while sm2_io::clock::now() < until {
            // Each look costs the subscriber, which writes to the same memory.
            for _ in 0..PAUSES {
                std::hint::spin_loop();
            }
            let is_done = self
                .handle
                .with_idle(|interface, tools| interface.publish_more(offered, tools));
            if is_done {
                return true;
            }
        }
        false
    }

    //= SM2-QOS-002
    pub(super) fn wait_for_room(
        &self,
        publication: Publication,
    ) -> Result<Published, PublishError> {
        let (mut offered, deadline) = match publication {
            Publication::Done(published) => return Ok(published),
            Publication::Waiting { offered, deadline } => (offered, deadline),
        };
        let Handle { shared, id, .. } = &self.handle;
        let mut waited = Ok(None);
        if !self.spin_for_room(&mut offered) {
            waited = shared.wait(Topic::Interface(*id), Some(deadline), |inner| {
                let is_done = inner.with(*id, &shared.epoll, |interface, tools| {
                    interface.publish_more(&mut offered, tools)
                });
                (is_done == Some(true)).then_some(())
            });
        }
        let published = self.finish(offered);
        waited.map_err(PublishError::Io)?;
        Ok(published)
    }

    /// Drives the node, and sends to the links that have room by now. Returns whether none is left
    /// without room; otherwise the descriptor is silent until something happens.
    #[cfg(feature = "tokio")]
    pub(crate) fn send_more(&self, offered: &mut Offered) -> bool {
        let Handle { shared, id, .. } = &self.handle;
        let done = self.handle.look(&mut shared.driven(), |inner| {
            let is_done = inner.with(*id, &shared.epoll, |interface, tools| {
                interface.publish_more(offered, tools)
            });
            (is_done == Some(true)).then_some(())
        });
        done.is_some()
    }

    /// Ends the waiting: links that have no room miss this message.
    pub(crate) fn finish(&self, offered: Offered) -> Published {
        let published = self
            .handle
            .with_idle(|interface, tools| interface.finish(offered, tools));
        self.refill_spare();
        published
    }

    /// Prepares memory for the next sealed message, after the last one was sent.
    fn refill_spare(&self) {
        if let Ok(mut spare) = self.spare.try_lock() {
            spare.refill(sm2_io::clock::now);
        }
    }
}

/// A message that was published.
#[derive(Debug)]
pub(crate) enum Publication {
    /// Each link has the message, or misses it.
    Done(Published),
    /// Reliable links have no room, and are waited for until the deadline.
    Waiting { offered: Offered, deadline: Instant },
}
