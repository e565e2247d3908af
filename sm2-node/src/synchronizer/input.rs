//! The inputs of a synchronizer, with the messages that are held.

use std::collections::VecDeque;
use std::fmt;
use std::sync::Arc;
use std::time::Duration;

use sm2_proto::{Instant, Name};

use crate::driver::SharedInterface;
use crate::{DeclareError, Message, RecvError, Sample, Shutdown, Subscriber, SubscriberBuilder};

/// An input of a [`Synchronizer`](crate::Synchronizer): a subscriber, and the time of its messages.
///
/// A [`SubscriberBuilder`] is an input whose times are those of publication. This type is for all others:
///
/// ```
/// use sm2_node::synchronizer::Input;
/// use sm2_node::{Instant, Node};
///
/// # fn main() -> Result<(), Box<dyn std::error::Error>> {
/// # let domain = sm2_node::testing::TestDomain::new()?;
/// # let node = domain.node("detector")?;
/// // The first number of a scan is its time in seconds, by the clock of the laser.
/// let scans = node.subscriber_builder::<[f64]>("scan");
/// let scans = Input::new(scans).time(|scan| Instant((scan[0] * 1e9) as u64));
/// # Ok(())
/// # }
/// ```
pub struct Input<T: Message + ?Sized> {
    subscriber: SubscriberBuilder<T>,
    time: TimeOf<T>,
    min_period: Duration,
}

type TimeOf<T> = Box<dyn Fn(&Sample<T>) -> Instant + Send>;

impl<T: Message + ?Sized> Input<T> {
    /// An input whose times are those of publication: [`Sample::source_time`].
    pub fn new(subscriber: SubscriberBuilder<T>) -> Self {
        Self {
            subscriber,
            time: Box::new(Sample::source_time),
            min_period: Duration::ZERO,
        }
    }

    /// Sets the function that returns the time of a message, in nanoseconds of any clock that the inputs share. It is
    /// called once for each message.
    #[must_use]
    pub fn time(mut self, time: impl Fn(&Sample<T>) -> Instant + Send + 'static) -> Self {
        self.time = Box::new(time);
        self
    }

    /// Sets the shortest time between two messages of this input; zero by default. An approximate synchronizer then
    /// knows earlier that no better message can come, and returns its sets earlier. Choose about half of the period. If
    /// messages come sooner, a set may not be the best one; they are counted as
    /// [`too_soon`](super::InputCounters::too_soon).
    #[must_use]
    pub const fn min_period(mut self, period: Duration) -> Self {
        self.min_period = period;
        self
    }

    /// Declares the subscriber, which may hold at least `held` messages of each publisher.
    pub(super) fn declare(self, held: u16) -> Result<Slot<T>, DeclareError> {
        Ok(Slot {
            subscriber: self.subscriber.hold_at_least(held).declare()?,
            time: self.time,
            min_period: self.min_period,
            held: VecDeque::new(),
        })
    }
}

impl<T: Message + ?Sized> fmt::Debug for Input<T> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Input")
            .field("topic", &self.subscriber.topic())
            .field("min_period", &self.min_period)
            .finish_non_exhaustive()
    }
}

/// A value that can be an input of a [`Synchronizer`](crate::Synchronizer): an [`Input`] or a [`SubscriberBuilder`].
pub trait IntoInput {
    /// The type of the messages.
    type Message: Message + ?Sized;

    /// Returns the input.
    fn into_input(self) -> Input<Self::Message>;
}

impl<T: Message + ?Sized> IntoInput for Input<T> {
    type Message = T;

    fn into_input(self) -> Self {
        self
    }
}

impl<T: Message + ?Sized> IntoInput for SubscriberBuilder<T> {
    type Message = T;

    fn into_input(self) -> Input<T> {
        Input::new(self)
    }
}

/// A declared input and the messages that are held, the oldest first.
pub(super) struct Slot<T: Message + ?Sized> {
    subscriber: Subscriber<T>,
    time: TimeOf<T>,
    min_period: Duration,
    pub(super) held: VecDeque<Sample<T>>,
}

/// A declared input, whatever its type.
pub(super) trait AnySlot: Send {
    fn topic(&self) -> &Name;

    fn interface(&self) -> &Arc<SharedInterface>;

    /// The shutdown that ends the waits of its node.
    fn shutdown(&self) -> Option<&Shutdown>;

    fn min_period(&self) -> Duration;

    /// Takes a message, if there is one, and returns its time.
    fn take(&mut self) -> Result<Option<Instant>, RecvError>;

    fn drop_oldest(&mut self);

    fn drop_newest(&mut self);
}

impl<T: Message + ?Sized> AnySlot for Slot<T> {
    fn topic(&self) -> &Name {
        self.subscriber.topic()
    }

    fn interface(&self) -> &Arc<SharedInterface> {
        &self.subscriber.handle().interface
    }

    fn shutdown(&self) -> Option<&Shutdown> {
        self.subscriber.handle().shared.sets.shutdown_handle()
    }

    fn min_period(&self) -> Duration {
        self.min_period
    }

    fn take(&mut self) -> Result<Option<Instant>, RecvError> {
        let Some(sample) = self.subscriber.try_recv()? else {
            return Ok(None);
        };
        let time = (self.time)(&sample);
        self.held.push_back(sample);
        Ok(Some(time))
    }

    fn drop_oldest(&mut self) {
        self.held.pop_front();
    }

    fn drop_newest(&mut self) {
        self.held.pop_back();
    }
}
