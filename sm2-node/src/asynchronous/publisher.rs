//! Sending the messages of a topic with futures.

use std::borrow::Borrow;
use std::future::poll_fn;
use std::io;
use std::pin::Pin;
use std::sync::Arc;
use std::task::{Context, Poll, ready};

use futures_util::Sink;
use sm2_proto::WaitGrant;
use tokio::time::Sleep;

use super::{IntoAsync, Watched};
use crate::driver::Offered;
use crate::outgoing::Outgoing;
use crate::publisher::untyped::Publication;
use crate::{Message, PublishError, Published, Publisher, StoreError};

/// A [`Publisher`] for futures, and a [`Sink`] of messages.
///
/// Waits only for reliable subscribers without room, and at most for the publisher's
/// [`publish_timeout`](crate::PublisherBuilder::publish_timeout). As a sink it takes one message at a time;
/// [`PublishError::DeadlineExceeded`] reports that a reliable subscriber missed a message.
///
/// ```
/// use sm2_node::asynchronous::IntoAsync;
/// # #[tokio::main(flavor = "current_thread")]
/// # async fn main() -> Result<(), Box<dyn std::error::Error>> {
/// # let domain = sm2_node::testing::TestDomain::new()?;
/// # let heard = domain.node("listener")?.subscriber::<str>("chatter")?;
/// # let node = domain.node("talker")?;
/// let topic = node.publisher::<str>("chatter")?;
/// topic.wait_for_subscribers(1)?;
/// let mut topic = topic.into_async()?;
/// topic.publish("hello").await?;
/// # assert_eq!(&*heard.recv()?, "hello");
/// # Ok(())
/// # }
/// ```
#[derive(Debug)]
pub struct AsyncPublisher<T: Message + ?Sized> {
    publisher: Watched<Publisher<T>>,
    in_flight: Option<InFlight>,
    /// The result of the last publication, until it is taken.
    published: Option<Published>,
}

/// A message that some reliable subscribers have no room for, and the timer of its deadline.
#[derive(Debug)]
struct InFlight {
    offered: Offered,
    grant: WaitGrant,
    sleep: Pin<Box<Sleep>>,
}

impl<T: Message + ?Sized> AsyncPublisher<T> {
    /// Sends one message to all subscribers whose links are open: see [`Publisher::publish`].
    ///
    /// If the future is dropped before it is ready, all subscribers with room have the message. The others
    /// get it during the next call of this publisher, or miss it.
    ///
    /// # Errors
    ///
    /// See [`PublishError`].
    pub async fn publish(&mut self, message: &T) -> Result<Published, PublishError> {
        poll_fn(|context| self.poll_in_flight(context))
            .await
            .map_err(PublishError::Io)?;
        self.start(message)?;
        poll_fn(|context| self.poll_in_flight(context))
            .await
            .map_err(PublishError::Io)?;
        Ok(self.published.take().unwrap_or_default())
    }

    /// Waits until every reliable subscriber has room: see [`Publisher::wait_for_room`].
    ///
    /// # Errors
    ///
    /// Errors of `epoll_ctl(2)`, such as no memory.
    pub async fn wait_for_room(&mut self) -> io::Result<()> {
        poll_fn(|context| {
            ready!(self.poll_in_flight(context))?;
            let publisher = &self.publisher;
            publisher.poll(context, |it| it.core.has_room().then_some(()))
        })
        .await
    }

    /// Returns the publisher.
    #[must_use]
    pub fn get_ref(&self) -> &Publisher<T> {
        self.publisher.get()
    }

    /// Turns this back into a publisher for threads. Subscribers that still have no room miss the message in
    /// flight.
    #[must_use]
    pub fn into_inner(self) -> Publisher<T> {
        let publisher = self.publisher.into_inner();
        if let Some(it) = self.in_flight {
            publisher.core.finish(it.offered, it.grant);
        }
        publisher
    }

    fn start(&mut self, message: &T) -> Result<(), PublishError> {
        let core = &self.publisher.get().core;
        let message = Outgoing::new(message).map_err(StoreError::Encode)?;
        match core.start(message, core.publish_timeout)? {
            Publication::Done(published) => self.published = Some(published),
            Publication::Waiting { offered, grant } => {
                let remaining = grant.until().since(sm2_io::clock::now());
                self.in_flight = Some(InFlight {
                    offered,
                    grant,
                    sleep: Box::pin(tokio::time::sleep(remaining)),
                });
            }
        }
        Ok(())
    }

    /// Waits until no subscriber is waited for.
    fn poll_in_flight(&mut self, context: &mut Context<'_>) -> Poll<io::Result<()>> {
        let Some(it) = &mut self.in_flight else {
            return Poll::Ready(Ok(()));
        };
        let offered = &mut it.offered;
        if it.sleep.as_mut().poll(context).is_pending() {
            let publisher = &self.publisher;
            let done = publisher.poll(context, |it| it.core.send_more(offered).then_some(()));
            ready!(done)?;
        }
        if let Some(it) = self.in_flight.take() {
            let published = (self.publisher.get().core).finish(it.offered, it.grant);
            self.published = Some(published);
        }
        Poll::Ready(Ok(()))
    }
}

impl<T: Message + ?Sized> IntoAsync for Publisher<T> {
    type Async = AsyncPublisher<T>;

    fn into_async(self) -> io::Result<AsyncPublisher<T>> {
        self.handle().try_descriptor()?;
        Ok(AsyncPublisher {
            publisher: Watched::new(self, Arc::default())?,
            in_flight: None,
            published: None,
        })
    }
}

impl<T: Message + ?Sized, M: Borrow<T>> Sink<M> for AsyncPublisher<T> {
    type Error = PublishError;

    fn poll_ready(
        mut self: Pin<&mut Self>,
        context: &mut Context<'_>,
    ) -> Poll<Result<(), PublishError>> {
        ready!(self.poll_in_flight(context)).map_err(PublishError::Io)?;
        let published = self.published.take().unwrap_or_default();
        Poll::Ready(published.complete().map(drop))
    }

    fn start_send(mut self: Pin<&mut Self>, message: M) -> Result<(), PublishError> {
        self.start(message.borrow())
    }

    fn poll_flush(
        self: Pin<&mut Self>,
        context: &mut Context<'_>,
    ) -> Poll<Result<(), PublishError>> {
        Sink::<M>::poll_ready(self, context)
    }

    fn poll_close(
        self: Pin<&mut Self>,
        context: &mut Context<'_>,
    ) -> Poll<Result<(), PublishError>> {
        Sink::<M>::poll_ready(self, context)
    }
}
