//! Answering the calls of a service with futures.

use std::borrow::Borrow;
use std::convert::Infallible;
use std::fmt::Display;
use std::io;
use std::pin::{Pin, pin};
use std::sync::Arc;
use std::task::{Context, Poll};

use futures_util::future::{Either, select};
use futures_util::stream::{FuturesUnordered, Stream, StreamExt};

use super::{IntoAsync, Watched};
use crate::{Message, RecvError, Request, Server};

/// A [`Server`] for futures, and an endless [`Stream`] of its requests.
///
/// ```
/// use sm2_node::asynchronous::IntoAsync;
/// # #[tokio::main(flavor = "current_thread")]
/// # async fn main() -> Result<(), Box<dyn std::error::Error>> {
/// # let domain = sm2_node::testing::TestDomain::new()?;
/// # let client = domain.node("calculator")?.client::<u64, u64>("double")?;
/// # let node = domain.node("doubler")?;
/// let server = node.server::<u64, u64>("double")?.into_async()?;
/// # client.wait_for_servers(1)?;
/// # let call = client.send(&21)?;
/// let request = server.recv().await?;
/// let twice = *request * 2;
/// request.reply(&twice)?;                         // never waits
/// # assert_eq!(*call.wait()?, 42);
/// # Ok(())
/// # }
/// ```
#[derive(Debug)]
pub struct AsyncServer<Q: Message + ?Sized, R: Message + ?Sized>(Watched<Server<Q, R>>);

impl<Q: Message + ?Sized, R: Message + ?Sized> AsyncServer<Q, R> {
    /// Waits for the next request. Cancellation-safe. Several tasks may wait; each request goes to one of
    /// them.
    ///
    /// # Errors
    ///
    /// See [`RecvError`].
    pub async fn recv(&self) -> Result<Request<Q, R>, RecvError> {
        let received = self.0.wait(|it| it.try_recv().transpose()).await;
        received.map_err(RecvError::Io)?
    }

    /// Answers every request with an async function, up to `concurrency` of them at a time, for as long as
    /// the future is polled. An error of the function is sent to the client. Dropping the future answers
    /// the pending requests as failed.
    ///
    /// # Errors
    ///
    /// See [`RecvError`]. A request that cannot be read is answered as failed and skipped.
    pub async fn serve<M: Borrow<R>, E: Display>(
        &self,
        concurrency: usize,
        answer: impl AsyncFn(&Request<Q, R>) -> Result<M, E>,
    ) -> Result<Infallible, RecvError> {
        let answer = &answer;
        let mut running = FuturesUnordered::new();
        loop {
            let next = match running.len() < concurrency.max(1) {
                true => match select(pin!(self.recv()), running.next()).await {
                    Either::Left((next, _)) => next,
                    // An empty set is ready at once; then only requests are waited for.
                    Either::Right((None, next)) => next.await,
                    Either::Right((Some(()), _)) => continue,
                },
                false => {
                    running.next().await;
                    continue;
                }
            };
            match next {
                Ok(request) => running.push(async move {
                    let result = match answer(&request).await {
                        Ok(reply) => request.reply(reply.borrow()),
                        Err(error) => request.fail(&error.to_string()),
                    };
                    if let Err(error) = result {
                        tracing::debug!(%error, "a reply was not sent");
                    }
                }),
                Err(RecvError::Payload { .. }) => {}
                // A client holds its maximum of pending requests: answer some before taking more.
                Err(RecvError::TooManyBorrowed { .. }) if !running.is_empty() => {
                    running.next().await;
                }
                Err(error) => return Err(error),
            }
        }
    }

    /// Returns the server.
    #[must_use]
    pub fn get_ref(&self) -> &Server<Q, R> {
        self.0.get()
    }

    /// Turns this back into a server for threads.
    #[must_use]
    pub fn into_inner(self) -> Server<Q, R> {
        self.0.into_inner()
    }
}

impl<Q: Message + ?Sized, R: Message + ?Sized> IntoAsync for Server<Q, R> {
    type Async = AsyncServer<Q, R>;

    fn into_async(self) -> io::Result<AsyncServer<Q, R>> {
        self.handle().try_descriptor()?;
        Watched::new(self, Arc::default()).map(AsyncServer)
    }
}

impl<Q: Message + ?Sized, R: Message + ?Sized> Stream for AsyncServer<Q, R> {
    type Item = Result<Request<Q, R>, RecvError>;

    fn poll_next(self: Pin<&mut Self>, context: &mut Context<'_>) -> Poll<Option<Self::Item>> {
        let received = self.0.poll(context, |it| it.try_recv().transpose());
        received.map(|it| Some(it.unwrap_or_else(|error| Err(RecvError::Io(error)))))
    }
}
