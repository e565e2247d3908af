//! Calling a service.

mod reply;

use std::fmt;
use std::marker::PhantomData;
use std::sync::Arc;
use std::time::Duration;

use sm2_io::memfd::Side;
use sm2_proto::{Contract, Instant, Kind, Name, ServiceQos, TypeId};

use crate::driver::{
    CallBody, CallId, Choice, Drive, Needs, Outcome, PoolLimit, SharedInterface, SharedNode,
    WaitFailure,
};
use crate::executor::runs;
use crate::handle::declaration::{
    Declaration, inline_max_setter, max_len_setter, schema_of, sealed_setter, wait_setter,
};
use crate::handle::methods::interface_methods;
use crate::handle::receive::Unreadable;
use crate::handle::{Handle, until};
use crate::outgoing::Outgoing;
use crate::{CallError, DeclareError, Message, StoreError, Wait};

pub use self::reply::Reply;

/// Sends requests of type `Q` to the servers of a service, and gets replies of type `R`.
///
/// A call goes to one server: the one with the fewest pending calls and unreleased replies of this client,
/// counted together. Among equals, the server that has been linked for the longest time is chosen
/// (SM2-SRV-005). When a server ends, its calls fail at
/// once (SM2-SRV-004). They are not repeated elsewhere, because the server may have executed them.
///
/// The client's [descriptor](std::os::fd::AsFd) is readable when a [`Call::try_wait`] may have a result: call
/// it for all pending calls, then poll again.
///
/// ```
/// # fn main() -> Result<(), Box<dyn std::error::Error>> {
/// # let domain = sm2_node::testing::TestDomain::new()?;
/// # let adder = domain.node("adder")?;
/// # let server = adder.server::<[f64], f64>("sum")?;
/// # std::thread::spawn(move || while let Ok(request) = server.recv() {
/// #     let sum = request.iter().sum();
/// #     request.reply(&sum).unwrap();
/// # });
/// # let node = domain.node("calculator")?;
/// use std::time::Duration;
///
/// let client = node.client::<[f64], f64>("sum")?;
/// client.wait_for_servers(1)?;
/// let sum = client.call_timeout(&[1.0, 2.5], Duration::from_secs(60))?;
/// assert_eq!(*sum, 3.5);
///
/// let call = client.send(&[4.0])?;                // the program does something else meanwhile
/// assert_eq!(*call.wait()?, 4.0);
/// # Ok(())
/// # }
/// ```
#[derive(Debug)]
pub struct Client<Q: Message + ?Sized, R: Message + ?Sized> {
    handle: Arc<Handle>,
    calls: PhantomData<fn(&Q) -> Box<R>>,
}

interface_methods! {
    Client<Q, R>,
    service: "The name of its service.",
    "servers": wait_for_servers, wait_for_servers_timeout,
}

impl<Q: Message + ?Sized, R: Message + ?Sized> Client<Q, R> {
    pub(crate) fn handle(&self) -> &Handle {
        &self.handle
    }

    /// Sends a request and waits for the reply, without a time limit. If the server ends, the call fails at
    /// once (SM2-SRV-004).
    ///
    /// # Errors
    ///
    /// See [`CallError`].
    pub fn call(&self, request: &Q) -> Result<Reply<R>, CallError> {
        self.send(request)?.wait()
    }

    /// Sends a request and waits for the reply, for at most `timeout`.
    ///
    /// # Errors
    ///
    /// See [`CallError`].
    pub fn call_timeout(&self, request: &Q, timeout: Duration) -> Result<Reply<R>, CallError> {
        self.send_timeout(request, timeout)?.wait()
    }

    /// Sends a request without a deadline. The returned [`Call`] waits for its reply.
    ///
    /// Returns at once, except while the link to the first server is being opened: then it waits for that
    /// link.
    ///
    /// # Errors
    ///
    /// See [`CallError`].
    pub fn send(&self, request: &Q) -> Result<Call<R>, CallError> {
        self.send_until(request, None)
    }

    /// Sends a request with a deadline of `timeout` from now. The server learns the deadline, and
    /// [`Call::wait`] ends then.
    ///
    /// Returns at once, except while the link to the first server is being opened: then it waits for that
    /// link, for at most `timeout`.
    ///
    /// # Errors
    ///
    /// See [`CallError`].
    pub fn send_timeout(&self, request: &Q, timeout: Duration) -> Result<Call<R>, CallError> {
        self.send_until(request, until(Some(timeout)))
    }

    fn send_until(&self, request: &Q, deadline: Option<Instant>) -> Result<Call<R>, CallError> {
        let request = Outgoing::new(request).map_err(StoreError::Encode)?;
        let now = sm2_io::clock::now();
        let mut locked = (self.handle.interface).enter_at(now, Drive::IfDue);
        let call = locked.change_unharvested(|interface, context| {
            interface.call_on_road(&request, deadline, context)
        });
        drop(locked);
        if let Some(call) = call {
            return Ok(self.pending(call, deadline, now));
        }
        let needs = self.server(request.len() as u64, deadline)?;
        self.send_to(needs, request, deadline)
    }

    /// Sends a request if a server is linked; `None` while the link to the first server is being opened.
    #[cfg(feature = "tokio")]
    pub(crate) fn try_send(
        &self,
        bytes: &[u8],
        deadline: Option<Instant>,
    ) -> Result<Option<Call<R>>, CallError> {
        let len = bytes.len() as u64;
        let mut locked = self.handle.interface.enter(Drive::Yes);
        let choice = locked.change(|interface, _| interface.wait_for_server(len));
        if matches!(choice, Choice::Opening) {
            self.handle.clear(&mut locked);
        }
        drop(locked);
        match choice {
            Choice::Opening => Ok(None),
            Choice::Link { needs, .. } => self.send_to(needs, bytes.into(), deadline).map(Some),
            other => Err(self.no_server(other, len)),
        }
    }

    fn send_to(
        &self,
        needs: Needs,
        request: Outgoing<'_>,
        deadline: Option<Instant>,
    ) -> Result<Call<R>, CallError> {
        let (len, now) = (request.len() as u64, sm2_io::clock::now());
        let forms = self.handle.store(request, needs)?;
        // Chooses the server again, because other calls may have been sent meanwhile.
        let call = self.handle.with(Drive::No, |interface, context| {
            match interface.calls.choose_server(len, &interface.links) {
                Choice::Link { token, .. } => {
                    let body = CallBody::Stored(forms);
                    Ok(interface.call(token, body, len, deadline, context))
                }
                other => {
                    interface.drop_forms(forms, context);
                    Err(other)
                }
            }
        });
        let call = call.map_err(|choice| self.no_server(choice, len))?;
        Ok(self.pending(call, deadline, now))
    }

    fn pending(&self, call: CallId, deadline: Option<Instant>, began: Instant) -> Call<R> {
        Call {
            call,
            handle: Arc::clone(&self.handle),
            deadline,
            began,
            done: false,
            replies: PhantomData,
        }
    }

    /// Waits until the service has a server with an open link. Returns the payload form that the server
    /// needs for a request of this length.
    fn server(&self, len: u64, deadline: Option<Instant>) -> Result<Needs, CallError> {
        let found = (self.handle.interface).wait(deadline, |interface, _| {
            match interface.wait_for_server(len) {
                Choice::Opening => None,
                choice => Some(choice),
            }
        });
        match found.map_err(|error| failed(&self.handle.name, error))? {
            Some(Choice::Link { needs, .. }) => Ok(needs),
            Some(choice) => Err(self.no_server(choice, len)),
            None => Err(CallError::DeadlineExceeded {
                service: self.handle.name.clone(),
            }),
        }
    }

    fn no_server(&self, choice: Choice, len: u64) -> CallError {
        let service = self.handle.name.clone();
        match choice {
            Choice::TooLong { max_len } => CallError::TooLong {
                service,
                len,
                max_len,
            },
            Choice::TooMany { limit } => CallError::TooManyCalls { service, limit },
            Choice::Link { .. } | Choice::Opening | Choice::NoServer => {
                CallError::NoServer { service }
            }
        }
    }
}

#[cfg(feature = "tokio")]
impl<Q: Message + ?Sized, R: Message + ?Sized> Client<Q, R> {
    /// See [`Handle::cleared`].
    pub(crate) fn cleared(&self) -> Arc<tokio::sync::Notify> {
        Arc::clone(&self.handle.cleared)
    }
}

/// A pending call. Dropping it cancels the call.
#[must_use = "a call that is dropped is cancelled"]
pub struct Call<R: Message + ?Sized> {
    handle: Arc<Handle>,
    call: CallId,
    deadline: Option<Instant>,
    /// The time when the program began to send it.
    began: Instant,
    /// Whether the result has been returned.
    done: bool,
    replies: PhantomData<fn() -> Box<R>>,
}

impl<R: Message + ?Sized> Call<R> {
    /// Waits for the reply, until the call's deadline if it has one. At the deadline the call is cancelled at
    /// the server.
    ///
    /// In a callback of the [executor](crate::Executor) that would have to serve the call, this fails at once with
    /// [`CallError::OwnExecutor`].
    ///
    /// # Errors
    ///
    /// See [`CallError`].
    pub fn wait(mut self) -> Result<Reply<R>, CallError> {
        if runs::waits_for_itself(&self.handle.interface, self.call.token, self.began) {
            return Err(CallError::OwnExecutor {
                service: self.handle.name.clone(),
            });
        }
        match self.reply_until(self.handle.wait, self.deadline)? {
            Some(reply) => Ok(reply),
            None => Err(CallError::DeadlineExceeded {
                service: self.handle.name.clone(),
            }),
        }
    }

    /// Returns the reply if it has arrived. After the reply or an error, there is no further result.
    ///
    /// # Errors
    ///
    /// See [`CallError`].
    pub fn try_wait(&mut self) -> Result<Option<Reply<R>>, CallError> {
        let reply = self.reply_until(Wait::Park, Some(Instant(0)))?;
        let late = self.deadline.is_some_and(|it| it <= sm2_io::clock::now());
        if reply.is_none() && !self.done && late {
            self.forget();
            return Err(CallError::DeadlineExceeded {
                service: self.handle.name.clone(),
            });
        }
        Ok(reply)
    }

    pub(crate) fn interface(&self) -> &Arc<SharedInterface> {
        &self.handle.interface
    }

    pub(crate) const fn id(&self) -> CallId {
        self.call
    }

    pub(crate) const fn deadline(&self) -> Option<Instant> {
        self.deadline
    }

    /// Cancels the call at the server. Waiting then ends with [`CallError::Cancelled`], or with the reply if
    /// that arrives first.
    pub fn cancel(&self) {
        let call = self.call;
        self.handle
            .with_driven(|interface, context| interface.cancel(call, context));
    }

    fn reply_until(
        &mut self,
        way: Wait,
        until: Option<Instant>,
    ) -> Result<Option<Reply<R>>, CallError> {
        let call = self.call;
        let outcome = (self.handle.interface).wait_as(way, until.into(), |locked| {
            self.handle.find_or_clear(locked, |locked| {
                locked.change(|interface, context| interface.outcome(call, context))
            })
        });
        let outcome = outcome.map_err(|error| failed(&self.handle.name, error))?;
        self.done |= outcome.is_some();
        let service = self.handle.name.clone();
        match outcome {
            None => Ok(None),
            Some(Outcome::Reply(taken)) => match self.handle.open_for(taken) {
                Ok(received) => Reply::new(service, received).map(Some),
                Err(Unreadable {
                    side: Side::Sender, ..
                }) => Err(CallError::ServerGone { service }),
                Err(Unreadable { source, .. }) => Err(CallError::Map { service, source }),
            },
            Some(Outcome::ServerGone) => Err(CallError::ServerGone { service }),
        }
    }

    fn forget(&mut self) {
        if !self.done {
            self.done = true;
            let call = self.call;
            self.handle
                .with_driven(|interface, context| interface.forget(call, context));
        }
    }
}

impl<R: Message + ?Sized> Drop for Call<R> {
    fn drop(&mut self) {
        self.forget();
    }
}

impl<R: Message + ?Sized> fmt::Debug for Call<R> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Call")
            .field("service", &self.handle.name)
            .field("id", &self.call.id)
            .finish_non_exhaustive()
    }
}

fn failed(service: &Name, failure: WaitFailure) -> CallError {
    let service = service.clone();
    match failure {
        WaitFailure::Shutdown => CallError::Shutdown { service },
        WaitFailure::Io(source) => CallError::Io { service, source },
    }
}

/// Options of a client.
#[derive(Debug)]
#[must_use = "a builder does nothing until declare is called"]
pub struct ClientBuilder<Q: Message + ?Sized, R: Message + ?Sized> {
    declaration: Declaration,
    /// `None` accepts every pair of types.
    types: Option<(TypeId, TypeId)>,
    qos: ServiceQos,
    servers: fn(&Name) -> bool,
    calls: PhantomData<fn(&Q) -> Box<R>>,
}

impl<Q: Message + ?Sized, R: Message + ?Sized> ClientBuilder<Q, R> {
    pub(crate) fn new(shared: &Arc<SharedNode>, service: &str) -> Self {
        Self {
            declaration: Declaration::new(shared, service),
            types: Some((Q::type_id(), R::type_id())),
            qos: ServiceQos {
                depth: 1,
                max_borrowed: 64,
                sealed: false,
            },
            servers: |_| true,
            calls: PhantomData,
        }
    }

    /// Sets how many pending calls and replies the program may hold per server: 1 to 1,024; 64 by default. Replies
    /// [in cells](crate#how-a-message-travels) do not count.
    pub const fn max_borrowed(mut self, calls: u16) -> Self {
        self.qos.max_borrowed = calls;
        self
    }

    sealed_setter!(
        qos,
        "Seals every request and reply: no process can change it after it is sent."
    );
    inline_max_setter!("Requests");
    max_len_setter!(
        "reply",
        "A server sends no longer one: the call fails with [`CallError::Failed`] (SM2-SRV-007)."
    );
    wait_setter!("a reply");

    /// Restricts calls to servers of nodes whose names `accept` admits; all servers by default.
    pub const fn servers(mut self, accept: fn(&Name) -> bool) -> Self {
        self.servers = accept;
        self
    }

    /// Declares the client, and waits for the Manager's answer.
    ///
    /// # Errors
    ///
    /// See [`DeclareError`].
    pub fn declare(self) -> Result<Client<Q, R>, DeclareError> {
        let contract = Contract::Client {
            service: self.declaration.checked_name(Kind::Client)?,
            types: self.types,
            qos: self.qos,
        };
        let schemas = [schema_of::<Q>(), schema_of::<R>()];
        let handle = self
            .declaration
            .declare(contract, PoolLimit::NONE, schemas)?;
        handle.with_undriven(|interface, _| interface.calls.servers = self.servers);
        Ok(Client {
            handle: Arc::new(handle),
            calls: PhantomData,
        })
    }
}

impl ClientBuilder<[u8], [u8]> {
    /// Calls servers of any pair of types, with requests and replies as bytes.
    pub fn any_types(mut self) -> Self {
        self.types = None;
        self
    }

    /// Calls servers of this pair of types, with requests and replies as bytes: for tools that handle types
    /// unknown at compile time.
    pub fn type_ids(mut self, request: TypeId, reply: TypeId) -> Self {
        self.types = Some((request, reply));
        self
    }
}
