//! Taking the events of a publisher, subscriber, server or client.

use std::sync::Arc;
use std::time::Duration;

use crate::driver::{SharedInterface, Until};
use crate::{Event, WaitError};

/// The events of a publisher, subscriber, server or client, in order: [`Subscriber::events`](crate::Subscriber::events)
/// and the same method of the others return it.
///
/// The first call of `events` begins with a [`Event::Joined`] for each link that is open. Up to 64 events wait to be
/// taken. One more displaces the oldest ([`dropped`](Self::dropped)), while `links` always tells the present state.
/// Losses on one link that follow each other are one event. All values for one interface share its events: each event
/// is taken once.
///
/// The events can be [added](crate::WaitSet::add) to a wait set. There are no further events once the publisher,
/// subscriber, server or client was dropped.
///
/// ```no_run
/// use sm2_node::{Event, Node};
///
/// # fn main() -> Result<(), Box<dyn std::error::Error>> {
/// let node = Node::new("stop-button")?;
/// let publisher = node.publisher::<str>("stop")?;
/// let events = publisher.events();
/// loop {
///     match events.next()? {
///         Event::Joined { peer } => println!("{} listens", peer.name),
///         Event::Left { peer, end } => println!("{} is gone: {end}", peer.name),
///         event => println!("{event:?}"),
///     }
/// }
/// # }
/// ```
#[derive(Clone, Debug)]
pub struct Events {
    pub(crate) interface: Arc<SharedInterface>,
}

impl Events {
    pub(crate) fn new(interface: &Arc<SharedInterface>) -> Self {
        (interface.lock()).change(|it, _| it.reports.enable_events(&mut it.links));
        Self {
            interface: Arc::clone(interface),
        }
    }

    /// Waits for the next event, without a time limit.
    ///
    /// # Errors
    ///
    /// [`WaitError::Shutdown`], [`WaitError::Io`].
    pub fn next(&self) -> Result<Event, WaitError> {
        loop {
            if let Some(event) = self.take(Until::Forever)? {
                return Ok(event);
            }
        }
    }

    /// Waits for the next event, for at most `timeout`.
    ///
    /// # Errors
    ///
    /// As [`next`](Self::next).
    pub fn next_timeout(&self, timeout: Duration) -> Result<Option<Event>, WaitError> {
        self.take(Until::In(timeout))
    }

    /// Returns the next event, if there is one.
    ///
    /// # Errors
    ///
    /// [`WaitError::Io`].
    pub fn try_next(&self) -> Result<Option<Event>, WaitError> {
        self.take(Until::NOW)
    }

    fn take(&self, until: Until) -> Result<Option<Event>, WaitError> {
        let way = crate::Wait::Park;
        let event =
            (self.interface).wait_as(way, until, |it| it.change(|it, _| it.reports.events.pop()));
        Ok(event?)
    }

    /// Takes the next event, if there is one, without driving the node.
    pub(crate) fn pop(&self) -> Option<Event> {
        (self.interface.lock()).change(|it, _| it.reports.events.pop())
    }

    /// How many events were displaced because the program did not take them in time.
    #[must_use]
    pub fn dropped(&self) -> u64 {
        self.interface.lock().interface().reports.events.dropped()
    }
}
