//! Receiving the messages of a topic with futures.

use std::io;
use std::pin::Pin;
use std::sync::Arc;
use std::task::{Context, Poll};

use futures_util::Stream;

use super::{IntoAsync, Watched};
use crate::{Message, RecvError, Sample, Subscriber};

/// A [`Subscriber`] for futures, and an endless [`Stream`] of its messages. A message that cannot be received
/// is an item with an error.
#[derive(Debug)]
pub struct AsyncSubscriber<T: Message + ?Sized>(Watched<Subscriber<T>>);

impl<T: Message + ?Sized> AsyncSubscriber<T> {
    /// Waits for the next message. Cancellation-safe. Several tasks may wait; each message goes to one of
    /// them.
    ///
    /// # Errors
    ///
    /// See [`RecvError`].
    pub async fn recv(&self) -> Result<Sample<T>, RecvError> {
        let received = self.0.wait(|it| it.try_recv().transpose()).await;
        received.map_err(RecvError::Io)?
    }

    /// Returns the subscriber.
    #[must_use]
    pub fn get_ref(&self) -> &Subscriber<T> {
        self.0.get()
    }

    /// Turns this back into a subscriber for threads.
    #[must_use]
    pub fn into_inner(self) -> Subscriber<T> {
        self.0.into_inner()
    }
}

impl<T: Message + ?Sized> IntoAsync for Subscriber<T> {
    type Async = AsyncSubscriber<T>;

    fn into_async(self) -> io::Result<AsyncSubscriber<T>> {
        self.handle().try_descriptor()?;
        Watched::new(self, Arc::default()).map(AsyncSubscriber)
    }
}

impl<T: Message + ?Sized> Stream for AsyncSubscriber<T> {
    type Item = Result<Sample<T>, RecvError>;

    fn poll_next(self: Pin<&mut Self>, context: &mut Context<'_>) -> Poll<Option<Self::Item>> {
        let received = self.0.poll(context, |it| it.try_recv().transpose());
        received.map(|it| Some(it.unwrap_or_else(|error| Err(RecvError::Io(error)))))
    }
}
