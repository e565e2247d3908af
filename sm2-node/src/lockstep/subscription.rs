//! A subscriber whose messages are handled in a fixed order.

use sm2_proto::clock::DomainTime;
use sm2_proto::{Instant, Name};

use super::InputsError;
use crate::executor::Failure;
use crate::{Message, RecvError, Sample, Subscriber};

/// The place of a message in the order of a turn: the name of the publisher's node, the time of publication, and the
/// number of the publication.
pub(super) type Place = (Name, Instant, u64);

/// How many messages are taken before their turn: a publisher of short ones, which are not held, could be faster than
/// they are taken.
const AHEAD_MAX: usize = 1_024;

/// A subscriber with the callback for its messages.
pub(super) trait Subscription<S> {
    fn topic(&self) -> &Name;

    /// Takes the available messages, as many as the program may hold, and not many that were published after `cut`.
    fn take(&mut self, cut: Instant) -> Result<(), RecvError>;

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

    fn take(&mut self, cut: Instant) -> Result<(), RecvError> {
        let is_ahead = |sample: &Sample<T>| sample.source_time() > cut;
        let mut ahead = self.taken.iter().filter(|it| is_ahead(it)).count();
        while ahead < AHEAD_MAX {
            match self.subscriber.try_recv() {
                Ok(Some(sample)) => {
                    ahead += usize::from(is_ahead(&sample));
                    self.taken.push(sample);
                }
                // The messages that are held are handled first.
                Ok(None) | Err(RecvError::TooManyBorrowed { .. }) => break,
                Err(error) => return Err(error),
            }
        }
        Ok(())
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

#[cfg(all(test, feature = "embedded-manager"))]
mod tests {
    use super::*;
    use crate::testing::TestDomain;

    /// A publisher that goes on for ever does not keep a turn from its end.
    #[test]
    fn few_messages_are_taken_before_their_turn() {
        let domain = TestDomain::new().unwrap();
        let publisher = domain.node("talker").unwrap();
        let publisher = publisher.publisher_builder::<u64>("topic").depth(1_024);
        let publisher = publisher.declare().unwrap();
        let subscriber = domain.node("listener").unwrap();
        let subscriber = subscriber.subscriber_builder::<u64>("topic").depth(1_024);
        let subscriber = subscriber.max_borrowed(1_024).declare().unwrap();
        publisher.wait_for_subscribers(1).unwrap();
        let mut callback = Callback {
            subscriber,
            callback: |(): &mut (), _: Sample<u64>, _: DomainTime| Ok(()),
            taken: Vec::new(),
        };
        let publish = |number| publisher.publish(&number).unwrap();
        (0..1_000).for_each(|number| assert_eq!(publish(number).links, 1));
        let cut = crate::now();
        Subscription::<()>::take(&mut callback, cut).unwrap();
        assert_eq!(callback.taken.len(), 1_000, "all of this turn");
        for _ in 0..3 {
            (0..1_000).for_each(|number| assert_eq!(publish(number).links, 1));
            Subscription::<()>::take(&mut callback, cut).unwrap();
        }
        assert_eq!(callback.taken.len(), 1_000 + AHEAD_MAX);
    }
}
