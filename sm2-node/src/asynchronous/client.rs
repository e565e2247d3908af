//! Calling a service with futures.

use std::io;
use std::time::Duration;

use sm2_proto::Instant;

use super::{IntoAsync, Watched};
use crate::handle::until;
use crate::{CallError, Client, Message, Reply, StoreError};

/// A [`Client`] for futures. Any number of calls can be pending.
///
/// ```
/// use sm2_node::asynchronous::IntoAsync;
/// # #[tokio::main(flavor = "current_thread")]
/// # async fn main() -> Result<(), Box<dyn std::error::Error>> {
/// # let domain = sm2_node::testing::TestDomain::new()?;
/// # let server = domain.node("doubler")?.server::<u64, u64>("double")?;
/// # std::thread::spawn(move || {
/// #     let request = server.recv().unwrap();
/// #     let twice = *request * 2;
/// #     request.reply(&twice).unwrap();
/// # });
/// # let node = domain.node("calculator")?;
/// let client = node.client::<u64, u64>("double")?;
/// client.wait_for_servers(1)?;
/// let client = client.into_async()?;
/// assert_eq!(*client.call(&21).await?, 42);
/// # Ok(())
/// # }
/// ```
#[derive(Debug)]
pub struct AsyncClient<Q: Message + ?Sized, R: Message + ?Sized>(Watched<Client<Q, R>>);

impl<Q: Message + ?Sized, R: Message + ?Sized> AsyncClient<Q, R> {
    /// Sends a request and waits for the reply, without a time limit. Dropping the future cancels
    /// the call.
    ///
    /// # Errors
    ///
    /// See [`CallError`].
    pub async fn call(&self, request: &Q) -> Result<Reply<R>, CallError> {
        self.call_until(request, None).await
    }

    /// Sends a request and waits for the reply, for at most `timeout`. Dropping the future cancels
    /// the call.
    ///
    /// # Errors
    ///
    /// See [`CallError`].
    ///
    /// # Panics
    ///
    /// If the runtime has no timer.
    pub async fn call_timeout(
        &self,
        request: &Q,
        timeout: Duration,
    ) -> Result<Reply<R>, CallError> {
        let reply = self.call_until(request, until(Some(timeout)));
        match tokio::time::timeout(timeout, reply).await {
            Ok(reply) => reply,
            Err(_) => Err(CallError::DeadlineExceeded {
                service: self.0.get().service().clone(),
            }),
        }
    }

    async fn call_until(
        &self,
        request: &Q,
        deadline: Option<Instant>,
    ) -> Result<Reply<R>, CallError> {
        let failed = |source| CallError::Io {
            service: self.0.get().service().clone(),
            source,
        };
        let bytes = request.bytes().map_err(StoreError::Encode)?;
        let sent = self.0.wait(|client| {
            let sent = client.try_send(&bytes, deadline);
            sent.transpose()
        });
        let mut call = sent.await.map_err(failed)??;
        let reply = self.0.wait(|_| call.try_wait().transpose());
        reply.await.map_err(failed)?
    }

    /// Returns the client.
    #[must_use]
    pub fn get_ref(&self) -> &Client<Q, R> {
        self.0.get()
    }

    /// Turns this back into a client for threads.
    #[must_use]
    pub fn into_inner(self) -> Client<Q, R> {
        self.0.into_inner()
    }
}

impl<Q: Message + ?Sized, R: Message + ?Sized> IntoAsync for Client<Q, R> {
    type Async = AsyncClient<Q, R>;

    fn into_async(self) -> io::Result<AsyncClient<Q, R>> {
        self.handle().try_descriptor()?;
        // Each task waits for its own reply. A task that clears the descriptor must tell the others.
        let cleared = self.cleared();
        Watched::new(self, cleared).map(AsyncClient)
    }
}
