//! Publishing many messages under one lock.

use super::Publisher;
use super::untyped::UntypedPublisher;
use crate::driver::Drive;
use crate::outgoing::Outgoing;
use crate::published::Published;
use crate::{Message, PublishError, StoreError};

/// How many messages are encoded before the first of them is sent.
const RUN: usize = 32;

impl<T: Message + ?Sized> Publisher<T> {
    /// Sends messages in order, as [`publish`](Self::publish) does, but faster if they are short. Messages of
    /// one call share their time of publication in groups of at most 32.
    ///
    /// In the result, [`links`](Published::links) is that of the last message, and
    /// [`missed`](Published::missed) and [`too_long`](Published::too_long) are the sums over all messages.
    ///
    /// # Errors
    ///
    /// See [`PublishError`]. The messages before the one that failed were sent.
    pub fn publish_all<'a>(
        &self,
        messages: impl IntoIterator<Item = &'a T>,
    ) -> Result<Published, PublishError>
    where
        T: 'a,
    {
        let mut messages = messages.into_iter().map(Outgoing::new);
        let mut run = Vec::with_capacity(RUN);
        let mut sum = Published::default();
        loop {
            // Without the lock, because the iterator is the program's code.
            let encoded = messages.by_ref().take(RUN).try_for_each(|message| {
                run.push(message?);
                Ok(())
            });
            let is_last = run.len() < RUN;
            self.core.publish_run(&mut run, &mut sum)?;
            encoded.map_err(StoreError::Encode)?;
            if is_last {
                return Ok(sum);
            }
        }
    }
}

impl UntypedPublisher {
    /// Publishes and removes all of these messages.
    fn publish_run(
        &self,
        run: &mut Vec<Outgoing<'_>>,
        sum: &mut Published,
    ) -> Result<(), PublishError> {
        let mut rest = run.drain(..);
        loop {
            let sent = self.publish_to_rings(rest.as_slice(), sum);
            // The next message is long, or a reliable link has no room for it.
            let Some(message) = rest.by_ref().nth(sent) else {
                return Ok(());
            };
            sum.add(self.publish_off_road(message, self.publish_timeout)?);
        }
    }

    /// Publishes messages under one lock, as long as they are short and the rings of all links have room.
    /// Returns how many were published.
    #[inline]
    pub(super) fn publish_to_rings(&self, messages: &[Outgoing<'_>], sum: &mut Published) -> usize {
        let now = sm2_io::clock::now();
        let mut locked = (self.handle.interface).enter_at(now, Drive::IfDue);
        let is_driven = locked.is_driven;
        locked.change_unharvested(|interface, context| {
            // Without driving, the publisher reads released slots only when it needs one: a receiver that
            // keeps up writes to the same memory all the time.
            if is_driven {
                interface.harvest(context);
            }
            interface.publish_to_rings(messages, now, context, sum)
        })
    }
}
