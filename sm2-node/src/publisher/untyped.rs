//! The part of a publisher that does not depend on the message type.

use std::array;
use std::io;
use std::os::fd::OwnedFd;
use std::sync::{Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use sm2_io::Preallocated;
use sm2_proto::{Instant, WaitBudget, WaitGrant};

#[cfg(feature = "tokio")]
use crate::driver::{Context, DeclaredInterface};
use crate::driver::{Drive, Forms, Offered};
use crate::handle::{Handle, until};
use crate::outgoing::Outgoing;
use crate::published::Published;
use crate::spare::{self, Fill, SpareMemory};
use crate::{PublishError, StoreError, Wait, WaitError};

/// How long a publication spins for room before it sleeps: about as long as falling asleep and waking up
/// takes.
const SPIN: Duration = Duration::from_micros(20);

/// Processor pauses between two checks for room, during which the shared memory is left alone.
const PAUSES: u32 = 64;

/// A publisher without its message type.
#[derive(Debug)]
pub(crate) struct UntypedPublisher {
    pub(crate) handle: Handle,
    /// Held during a publication that leaves the road, so that each link carries messages in order.
    pub(super) order: Mutex<()>,
    /// See [`publish_timeout`](crate::PublisherBuilder::publish_timeout).
    pub(crate) publish_timeout: Duration,
    /// How long publications may wait for reliable links.
    budget: Mutex<WaitBudget>,
    /// Memory for the next sealed message.
    spare: Mutex<SpareMemory>,
}

impl UntypedPublisher {
    pub(super) const fn new(
        handle: Handle,
        publish_timeout: Duration,
        wait_share_percent: u8,
        idle: Duration,
    ) -> Self {
        Self {
            handle,
            order: Mutex::new(()),
            publish_timeout,
            budget: Mutex::new(WaitBudget::new(wait_share_percent)),
            spare: Mutex::new(SpareMemory::new(idle)),
        }
    }

    pub(super) fn flush(&self, timeout: Option<Duration>) -> Result<bool, WaitError> {
        let flushed = (self.handle.interface).wait(until(timeout), |interface, _| {
            let flushed = interface.links.iter().all(|link| link.is_flushed());
            flushed.then_some(())
        });
        Ok(flushed?.is_some())
    }

    /// Publishes a message, and waits at most `timeout` for reliable links without room.
    pub(crate) fn publish(
        &self,
        message: Outgoing<'_>,
        timeout: Duration,
    ) -> Result<Published, PublishError> {
        if let Some(published) = self.publish_one_to_rings(&message) {
            return Ok(published);
        }
        self.publish_off_road(message, timeout)
    }

    /// Publishes a message in the general way, and waits at most `timeout` for reliable links without room.
    pub(super) fn publish_off_road(
        &self,
        message: Outgoing<'_>,
        timeout: Duration,
    ) -> Result<Published, PublishError> {
        let _order = self.order();
        let publication = self.start(message, timeout)?;
        self.complete(publication)
    }

    fn order(&self) -> MutexGuard<'_, ()> {
        self.order.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Publishes a message unless the publication would wait: then `None`, and no link gets the message.
    pub(super) fn try_publish(
        &self,
        message: Outgoing<'_>,
    ) -> Result<Option<Published>, PublishError> {
        if let Some(published) = self.publish_one_to_rings(&message) {
            return Ok(Some(published));
        }
        let _order = self.order();
        if !(self.handle).with(Drive::UnlessRings, |interface, _| interface.has_room()) {
            return Ok(None);
        }
        let len = message.len() as u64;
        match self.store(message) {
            Ok(forms) => Ok(self.offer_to_all(forms, len)),
            // A reliable link that holds the memory is suspended now.
            Err(_) if !(self.handle).with_undriven(|interface, _| interface.has_room()) => Ok(None),
            Err(error) => self.miss(error, len).map(Some),
        }
    }

    /// Publishes a message if it is short and the rings of all links have room.
    #[inline]
    fn publish_one_to_rings(&self, message: &Outgoing<'_>) -> Option<Published> {
        let mut published = Published::default();
        let count = self.publish_to_rings(array::from_ref(message), &mut published);
        (count == 1).then_some(published)
    }

    /// Waits until a publication would not wait, for at most `timeout`. Returns whether that is so.
    pub(super) fn wait_for_room(&self, timeout: Option<Duration>) -> Result<bool, WaitError> {
        let way = Wait::SpinThenPark(SPIN);
        let found = (self.handle.interface).wait_as(way, timeout.into(), |locked| {
            locked.change(|interface, _| interface.has_room().then_some(()))
        });
        Ok(found?.is_some())
    }

    /// Sends a message to all links that have room now.
    pub(crate) fn start(
        &self,
        message: Outgoing<'_>,
        timeout: Duration,
    ) -> Result<Publication, PublishError> {
        let len = message.len() as u64;
        match self.store(message) {
            Ok(forms) => Ok(self.offer(forms, len, timeout)),
            Err(error) => self.miss(error, len).map(Publication::Done),
        }
    }

    /// Stores a message in the forms that the links need.
    fn store(&self, message: Outgoing<'_>) -> Result<Forms, StoreError> {
        let len = message.len() as u64;
        let needs = self
            .handle
            .with(Drive::UnlessRings, |interface, _| interface.needs(len));
        let spare = |len, fill| self.take_spare(len, fill);
        self.handle.store_with(message, needs, spare)
    }

    /// Counts a message without memory as lost on all links if subscribers hold the memory.
    fn miss(&self, error: StoreError, len: u64) -> Result<Published, PublishError> {
        if !matches!(error, StoreError::PoolFull { .. }) {
            return Err(error.into());
        }
        let now = sm2_io::clock::now();
        let missed =
            (self.handle).with_undriven(|interface, context| interface.miss(now, len, context));
        Ok(missed.ok_or(error)?)
    }

    /// Takes prepared memory for a sealed message of `len` bytes, if there is any.
    pub(crate) fn take_spare(&self, len: usize, fill: Fill) -> Option<Preallocated> {
        // While another thread refills it, none is available.
        let mut spare = self.spare.try_lock().ok()?;
        spare.take(len, fill, sm2_io::clock::now())
    }

    /// Returns a sealed copy of `bytes`.
    pub(crate) fn seal(&self, bytes: &[u8]) -> io::Result<OwnedFd> {
        spare::seal(self.take_spare(bytes.len(), Fill::Copy), bytes)
    }

    /// Publishes the forms of a loan, and waits at most `timeout` for reliable links without room. The caller has
    /// driven the node.
    pub(crate) fn publish_forms(
        &self,
        forms: Forms,
        len: u64,
        timeout: Duration,
    ) -> Result<Published, PublishError> {
        let _order = self.order();
        let publication = self.offer(forms, len, timeout);
        self.complete(publication)
    }

    /// Offers a stored message to all links, or to none: then `None`, and a reliable link has no room.
    fn offer_to_all(&self, forms: Forms, len: u64) -> Option<Published> {
        let now = sm2_io::clock::now();
        let published = self.handle.with_undriven(|interface, context| {
            // A link may have opened, or is suspended because it holds the memory.
            if !interface.has_room() {
                interface.drop_forms(forms, context);
                return None;
            }
            let offered = interface.publish(forms, now, len, context);
            interface.free_idle(now, context);
            Some(interface.finish(offered, context))
        });
        self.refill_spare();
        published
    }

    fn offer(&self, forms: Forms, len: u64, timeout: Duration) -> Publication {
        let now = sm2_io::clock::now();
        let publication = self.handle.with_undriven(|interface, context| {
            let offered = interface.publish(forms, now, len, context);
            interface.free_idle(now, context);
            if offered.waiting.is_empty() {
                return Publication::Done(interface.finish(offered, context));
            }
            //= SM2-QOS-004
            let grant = self.budget().grant(now, timeout);
            if grant.is_empty() {
                return Publication::Done(interface.finish(offered, context));
            }
            // Until it is finished, no message on the road overtakes this one.
            interface.waiting += 1;
            Publication::Waiting { offered, grant }
        });
        if let Publication::Done(_) = publication {
            self.refill_spare();
        }
        publication
    }

    /// Spins for a short time: a subscriber that is taking messages makes room sooner than this thread could
    /// fall asleep and wake up. Returns whether all links have the message.
    fn spin_for_room(&self, offered: &mut Offered, deadline: Instant) -> bool {
        let until = sm2_io::clock::now().after(SPIN).min(deadline);
        while sm2_io::clock::now() < until {
            // Each check slows down the subscriber, which writes to the same memory.
            for _ in 0..PAUSES {
                std::hint::spin_loop();
            }
            let is_done = self
                .handle
                .with_undriven(|interface, context| interface.publish_more(offered, context));
            if is_done {
                return true;
            }
        }
        false
    }

    /// Waits until all links have the message, or the deadline has passed.
    //= SM2-QOS-002
    pub(super) fn complete(&self, publication: Publication) -> Result<Published, PublishError> {
        let (mut offered, grant) = match publication {
            Publication::Done(published) => return Ok(published),
            Publication::Waiting { offered, grant } => (offered, grant),
        };
        let mut waited = Ok(None);
        if !self.spin_for_room(&mut offered, grant.until()) {
            waited = (self.handle.interface).wait(Some(grant.until()), |interface, context| {
                let is_done = interface.publish_more(&mut offered, context);
                is_done.then_some(())
            });
        }
        let published = self.finish(offered, grant);
        waited?;
        Ok(published)
    }

    /// Drives the node, and sends to the links that have room now. Returns whether no link without room is
    /// left. If one is left, the descriptor is not readable until the next event.
    #[cfg(feature = "tokio")]
    pub(crate) fn send_more(&self, offered: &mut Offered) -> bool {
        self.is_so_or_clear(|interface, context| interface.publish_more(offered, context))
    }

    /// Drives the node. Returns whether a publication would not wait. If it would, the descriptor is not readable until
    /// the next event.
    #[cfg(feature = "tokio")]
    pub(crate) fn has_room(&self) -> bool {
        self.is_so_or_clear(|interface, _| interface.has_room())
    }

    #[cfg(feature = "tokio")]
    fn is_so_or_clear(
        &self,
        mut is_so: impl FnMut(&mut DeclaredInterface, &mut Context<'_>) -> bool,
    ) -> bool {
        let mut locked = self.handle.interface.enter(Drive::Yes);
        let found = self.handle.find_or_clear(&mut locked, |locked| {
            locked.change(&mut is_so).then_some(())
        });
        found.is_some()
    }

    /// Stops waiting: links that have no room miss this message.
    pub(crate) fn finish(&self, offered: Offered, grant: WaitGrant) -> Published {
        self.budget().charge(grant, sm2_io::clock::now());
        let published = self.handle.with_undriven(|interface, context| {
            interface.waiting -= 1;
            interface.finish(offered, context)
        });
        self.refill_spare();
        published
    }

    /// How long publications have waited for reliable links.
    pub(super) fn waited(&self) -> Duration {
        self.budget().waited()
    }

    fn budget(&self) -> MutexGuard<'_, WaitBudget> {
        self.budget.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Prepares memory for the next sealed message. Called after a message was sent.
    fn refill_spare(&self) {
        if let Ok(mut spare) = self.spare.try_lock() {
            spare.refill(sm2_io::clock::now);
        }
    }
}

/// The state of a publication.
#[derive(Debug)]
pub(crate) enum Publication {
    /// Each link has accepted or missed the message.
    Done(Published),
    /// Reliable links have no room; the publisher waits for them until the grant ends.
    Waiting { offered: Offered, grant: WaitGrant },
}
