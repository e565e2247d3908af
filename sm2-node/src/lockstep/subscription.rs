//! A subscriber whose messages are handled in a fixed order.

use sm2_proto::clock::DomainTime;
use sm2_proto::{Instant, Name};

use super::InputsError;
use crate::executor::Failure;
use crate::{Message, RecvError, Sample, Subscriber};

/// The place of a message in the order of a turn: the name of the publisher's node, the time of publication, and the
/// number of the publication.
pub(super) type Place = (Name, Instant, u64);

/// A subscriber with the callback for its messages.
pub(super) trait Subscription<S> {
    fn topic(&self) -> &Name;

    /// Takes the available messages, as many as the program may hold.
    fn take(&mut self) -> Result<(), RecvError>;

    /// The first one of the taken messages that were published until `cut`: its index and its place.
    fn first(&self, cut: Instant) -> Option<(usize, Place)>;

    /// Handles the taken message with this index.
    fn handle(&mut self, index: usize, state: &mut S, now: DomainTime) -> Result<(), Failure>;

    /// Handles the next message in the order of arrival. Returns false if there is none.
    fn handle_next(&mut self, state: &mut S, now: DomainTime) -> Result<bool, InputsError>;

    /// How many messages were lost before the taken message with this index.
    fn lost_before(&self, index: usize) -> u64;
}

pub(super) struct Callback<T: Message + ?Sized, F> {
    pub(super) subscriber: Subscriber<T>,
    pub(super) callback: F,
    /// Taken, and not handled yet, in the order of arrival.
    pub(super) taken: Vec<Sample<T>>,
}

/// As [`Place`], without a copy of the name.
fn place<T: Message + ?Sized>(sample: &Sample<T>) -> (&Name, Instant, u64) {
    (sample.publisher(), sample.source_time(), sample.sequence())
}

impl<S, T, F> Subscription<S> for Callback<T, F>
where
    T: Message + ?Sized,
    F: FnMut(&mut S, Sample<T>, DomainTime) -> Result<(), Failure>,
{
    fn topic(&self) -> &Name {
        self.subscriber.topic()
    }

    fn take(&mut self) -> Result<(), RecvError> {
        loop {
            match self.subscriber.try_recv() {
                Ok(Some(sample)) => self.taken.push(sample),
                // The messages that are held are handled first.
                Ok(None) | Err(RecvError::TooManyBorrowed { .. }) => return Ok(()),
                Err(error) => return Err(error),
            }
        }
    }

    fn first(&self, cut: Instant) -> Option<(usize, Place)> {
        let taken = self.taken.iter().enumerate();
        let due = taken.filter(|(_, it)| it.source_time() <= cut);
        let (index, sample) = due.min_by(|a, b| place(a.1).cmp(&place(b.1)))?;
        let (publisher, time, sequence) = place(sample);
        Some((index, (publisher.clone(), time, sequence)))
    }

    fn handle(&mut self, index: usize, state: &mut S, now: DomainTime) -> Result<(), Failure> {
        (self.callback)(state, self.taken.remove(index), now)
    }

    fn handle_next(&mut self, state: &mut S, now: DomainTime) -> Result<bool, InputsError> {
        let next = match self.taken.is_empty() {
            true => self.subscriber.try_recv().map_err(InputsError::Receive)?,
            false => Some(self.taken.remove(0)),
        };
        let Some(sample) = next else {
            return Ok(false);
        };
        (self.callback)(state, sample, now).map_err(InputsError::Callback)?;
        Ok(true)
    }

    fn lost_before(&self, index: usize) -> u64 {
        self.taken[index].lost()
    }
}
