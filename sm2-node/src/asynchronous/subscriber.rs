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
///
/// ```
/// use sm2_node::asynchronous::IntoAsync;
/// # #[tokio::main(flavor = "current_thread")]
/// # async fn main() -> Result<(), Box<dyn std::error::Error>> {
/// # let domain = sm2_node::testing::TestDomain::new()?;
/// # let topic = domain.node("talker")?.publisher_builder::<str>("chatter").latched(1).declare()?;
/// # topic.publish("hello")?;
/// # let node = domain.node("listener")?;
/// use futures_util::StreamExt;
///
/// let mut heard = node.subscriber::<str>("chatter")?.into_async()?;
/// assert_eq!(&*heard.recv().await?, "hello");
/// # topic.publish("hello")?;
/// while let Some(sample) = heard.next().await {   // it is a stream as well
///     println!("{}", &*sample?);
/// #   break;
/// }
/// # Ok(())
/// # }
/// ```
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
