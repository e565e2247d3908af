//! Sending the messages of a topic in futures.

use std::borrow::Borrow;
use std::future::poll_fn;
use std::io;
use std::pin::Pin;
use std::sync::Arc;
use std::task::{Context, Poll, ready};

use futures_util::Sink;
use tokio::time::Sleep;

use super::{IntoAsync, Watched};
use crate::publisher::untyped::Publication;
use crate::{Message, PublishError, Published, Publisher};

/// A [`Publisher`] for futures, and a [`Sink`] of messages.
///
/// Only reliable subscribers without room are waited for, at most as long as the publisher's
/// builder said. As a sink it takes one message at a time, and [`PublishError::DeadlineExceeded`]
/// says that a reliable subscriber missed one.
#[derive(Debug)]
pub struct AsyncPublisher<T: Message + ?Sized> {
    publisher: Watched<Publisher<T>>,
    /// What some reliable subscriber had no room for, and when it has waited long enough.
    under_way: Option<(Publication, Pin<Box<Sleep>>)>,
    /// What became of the last publication, until somebody asks.
    published: Option<Published>,
}

impl<T: Message + ?Sized> AsyncPublisher<T> {
    /// Sends one message to all subscribers whose links are open: see [`Publisher::publish`].
    ///
    /// If it is dropped before it is ready, the message has gone to everybody who had room; the
    /// others get it with the next call of this publisher, or not.
    ///
    /// # Errors
    ///
    /// See [`PublishError`].
    pub async fn publish(&mut self, message: &T) -> Result<Published, PublishError> {
        poll_fn(|context| self.poll_under_way(context))
            .await
            .map_err(PublishError::Io)?;
        self.start(message)?;
        poll_fn(|context| self.poll_under_way(context))
            .await
            .map_err(PublishError::Io)?;
        Ok(self.published.take().unwrap_or_default())
    }

    /// The publisher.
    #[must_use]
    pub fn get_ref(&self) -> &Publisher<T> {
        self.publisher.get()
    }

    /// The publisher, for threads again. Whoever is still waited for goes without the message.
    #[must_use]
    pub fn into_inner(self) -> Publisher<T> {
        let publisher = self.publisher.into_inner();
        if let Some((publication, _)) = self.under_way {
            publisher.core.finish(publication);
        }
        publisher
    }

    fn start(&mut self, message: &T) -> Result<(), PublishError> {
        let core = &self.publisher.get().core;
        let publication = core.start(message.bytes().map_err(crate::StoreError::Encode)?)?;
        if publication.is_done() {
            self.published = Some(core.finish(publication));
        } else {
            let remaining = publication.remaining();
            self.under_way = Some((publication, Box::pin(tokio::time::sleep(remaining))));
        }
        Ok(())
    }

    /// Waits until nobody is waited for.
    fn poll_under_way(&mut self, context: &mut Context<'_>) -> Poll<io::Result<()>> {
        let Some((publication, sleep)) = &mut self.under_way else {
            return Poll::Ready(Ok(()));
        };
        if sleep.as_mut().poll(context).is_pending() {
            let publisher = &self.publisher;
            let done = publisher.poll(context, |it| it.core.go_on(publication).then_some(()));
            ready!(done)?;
        }
        if let Some((publication, _)) = self.under_way.take() {
            let published = self.publisher.get().core.finish(publication);
            self.published = Some(published);
        }
        Poll::Ready(Ok(()))
    }
}

impl<T: Message + ?Sized> IntoAsync for Publisher<T> {
    type Async = AsyncPublisher<T>;

    fn into_async(self) -> io::Result<AsyncPublisher<T>> {
        Ok(AsyncPublisher {
            publisher: Watched::new(self, Arc::default())?,
            under_way: None,
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
        ready!(self.poll_under_way(context)).map_err(PublishError::Io)?;
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
