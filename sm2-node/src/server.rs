//! Answering the calls of a service.

use std::fmt;
use std::marker::PhantomData;
use std::ops::Deref;
use std::sync::Arc;
use std::time::Duration;

use bytes::Bytes;
use sm2_proto::control::LinkPeer;
use sm2_proto::link::Status;
use sm2_proto::{Contract, Instant, Kind, Name, ServiceQos, TypeId};

use crate::driver::{
    CallBody, CallId, DeclaredInterface, Drive, Needs, PoolLimit, SharedNode, Until,
};
use crate::handle::Handle;
use crate::handle::declaration::{
    Declaration, inline_max_setter, max_len_setter, schema_of, sealed_setter, wait_setter,
};
use crate::handle::methods::interface_methods;
use crate::handle::receive::{Receipt, Received};
use crate::outgoing::Outgoing;
use crate::{DeclareError, Message, RecvError, ReplyError, StoreError, Wait};

/// The error text for a client whose request was dropped.
const DROPPED: &str = "the server dropped the request without an answer";

/// The beginning of the error text for a client whose reply could not be stored.
const NOT_STORED: &str = "the server could not store the reply";

/// Receives requests of type `Q` and replies with messages of type `R`.
///
/// Several servers may serve one service; each call goes to one of them. Requests are taken from each client
/// in turn. If a request is cancelled or expires before the program takes it, the library answers it
/// (SM2-SRV-002).
///
/// The server's [descriptor](std::os::fd::AsFd) is readable when [`try_recv`](Self::try_recv) may have a
/// request. Dropping the server withdraws it, once all taken requests are answered.
///
/// ```
/// # fn main() -> Result<(), Box<dyn std::error::Error>> {
/// # let domain = sm2_node::testing::TestDomain::new()?;
/// # let client = domain.node("calculator")?.client::<[f64], f64>("sum")?;
/// # let node = domain.node("adder")?;
/// let server = node.server::<[f64], f64>("sum")?;
/// # client.wait_for_servers(1)?;
/// # let call = client.send(&[1.0, 2.5])?;
/// let request = server.recv()?;
/// if request.is_empty() {
///     request.fail("nothing to add")?;            // an error text for the client
/// } else {
///     let sum = request.iter().sum();
///     request.reply(&sum)?;
/// }
/// # assert_eq!(*call.wait()?, 3.5);
/// # Ok(())
/// # }
/// ```
#[derive(Debug)]
pub struct Server<Q: Message + ?Sized, R: Message + ?Sized> {
    handle: Arc<Handle>,
    serves: PhantomData<fn(&Q) -> Box<R>>,
}

interface_methods! {
    Server<Q, R>,
    service: "The name of its service.",
    "clients": wait_for_clients, wait_for_clients_timeout,
}

impl<Q: Message + ?Sized, R: Message + ?Sized> Server<Q, R> {
    pub(crate) fn handle(&self) -> &Handle {
        &self.handle
    }

    /// Waits for the next request, without a time limit. Waits also for a client, and while no Manager is
    /// running.
    ///
    /// # Errors
    ///
    /// See [`RecvError`].
    pub fn recv(&self) -> Result<Request<Q, R>, RecvError> {
        loop {
            if let Some(request) = self.take(Until::Forever)? {
                return Ok(request);
            }
        }
    }

    /// Returns the next request, if one has arrived.
    ///
    /// # Errors
    ///
    /// See [`RecvError`].
    pub fn try_recv(&self) -> Result<Option<Request<Q, R>>, RecvError> {
        self.take(Until::NOW)
    }

    /// Waits for the next request, for at most `timeout`.
    ///
    /// # Errors
    ///
    /// See [`RecvError`].
    pub fn recv_timeout(&self, timeout: Duration) -> Result<Option<Request<Q, R>>, RecvError> {
        self.take(Until::In(timeout))
    }

    fn take(&self, until: Until) -> Result<Option<Request<Q, R>>, RecvError> {
        let Some(received) = self
            .handle
            .receive(until, DeclaredInterface::take_request)?
        else {
            return Ok(None);
        };
        let Received {
            receipt,
            header,
            bytes,
        } = received;
        let pending = Pending {
            handle: Arc::clone(&self.handle),
            call: CallId {
                token: receipt.token(),
                id: header.id,
            },
            client: Arc::clone(receipt.peer()),
            answered: false,
        };
        match Q::view_in_place(bytes) {
            Ok(view) => Ok(Some(Request {
                pending,
                view,
                deadline: Some(header.time).filter(|time| time.0 != 0),
                _receipt: receipt,
                replies: PhantomData,
            })),
            Err(reason) => {
                let publisher = pending.client.name.clone();
                // The client gets a reply even if its request cannot be decoded.
                let _ = pending.fail(&reason.to_string());
                Err(RecvError::Payload { publisher, reason })
            }
        }
    }
}

/// A request. Dereferences to the message. Its client waits for the answer; dropping the request answers it
/// as failed.
pub struct Request<Q: Message + ?Sized, R: Message + ?Sized> {
    /// First: the reply is sent before the request is released.
    pending: Pending,
    view: Q::View,
    deadline: Option<Instant>,
    _receipt: Receipt,
    replies: PhantomData<fn() -> Box<R>>,
}

impl<Q: Message + ?Sized, R: Message + ?Sized> Request<Q, R> {
    /// Sends the reply. Never waits: replies that the client does not accept yet are queued.
    ///
    /// # Errors
    ///
    /// See [`ReplyError`].
    pub fn reply(self, reply: &R) -> Result<(), ReplyError> {
        // The request's memory stays valid until the reply is sent, since the reply may refer to it. Variables are
        // dropped in reverse order: the view before the receipt, also after a panic.
        let Self {
            _receipt,
            pending,
            view,
            ..
        } = self;
        let result = match Outgoing::new(reply) {
            Ok(reply) => pending.reply(reply, Status::Ok),
            Err(error) => {
                let _ = pending.fail(&error.to_string());
                Err(StoreError::Encode(error).into())
            }
        };
        drop(view);
        result
    }

    /// Answers that the request failed, with a reason.
    ///
    /// # Errors
    ///
    /// See [`ReplyError`].
    pub fn fail(self, reason: &str) -> Result<(), ReplyError> {
        self.pending.fail(reason)
    }

    /// Whether the reply is no longer wanted: the client cancelled the call or is gone, or the deadline has
    /// passed. Check this now and then during long work.
    #[must_use]
    pub fn is_cancelled(&self) -> bool {
        let call = self.pending.call;
        let late = self.deadline.is_some_and(|it| it <= sm2_io::clock::now());
        late || self
            .pending
            .handle
            .with_driven(|interface, _| interface.is_cancelled(call))
    }

    /// Returns the deadline, after which the reply is no longer wanted, in nanoseconds of the host's
    /// monotonic clock ([`now`](crate::now)).
    #[must_use]
    pub const fn deadline(&self) -> Option<Instant> {
        self.deadline
    }

    /// The name of the client's node.
    #[must_use]
    pub fn client(&self) -> &Name {
        &self.pending.client.name
    }
}

impl<Q: Message + ?Sized, R: Message + ?Sized> Deref for Request<Q, R> {
    type Target = Q;

    fn deref(&self) -> &Q {
        &self.view
    }
}

impl<Q: Message + ?Sized + fmt::Debug, R: Message + ?Sized> fmt::Debug for Request<Q, R> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Request")
            .field("client", &self.pending.client.name)
            .field("message", &&**self)
            .finish()
    }
}

/// A call without a reply. When this value is dropped, the call is answered as failed.
struct Pending {
    handle: Arc<Handle>,
    call: CallId,
    client: Arc<LinkPeer>,
    answered: bool,
}

impl Pending {
    fn reply(mut self, reply: Outgoing<'_>, status: Status) -> Result<(), ReplyError> {
        let call = self.call;
        let link = {
            let drive = Drive::UnlessRing(call.token);
            let mut locked = self.handle.interface.enter(drive);
            let sent = locked.change_unharvested(|interface, context| {
                interface.reply_on_road(call, &reply, status, context)
            });
            if sent.is_some() {
                self.answered = true;
                return Ok(());
            }
            let link = locked.interface().links.get(call.token);
            link.filter(|it| it.is_open())
                .map(|it| (it.needs(), it.peer_max_len()))
        };
        let gone = || ReplyError::ClientGone {
            client: self.client.name.clone(),
        };
        let Some((needs, max_len)) = link else {
            let error = gone();
            self.answered = true;
            return Err(error);
        };
        let len = reply.len() as u64;
        if len > max_len {
            return Err(self.refuse(len, max_len));
        }
        let forms = match self.handle.store(reply, needs) {
            Ok(forms) => forms,
            Err(error) => return Err(self.not_stored(error, needs)),
        };
        let sent = self.handle.with(Drive::No, |interface, context| {
            let body = CallBody::Stored(forms);
            interface.reply(call, body, len, status, context)
        });
        let result = if sent { Ok(()) } else { Err(gone()) };
        self.answered = true;
        result
    }

    /// Tells the client that it does not accept a reply of this length.
    //= SM2-SRV-007
    fn refuse(mut self, len: u64, max_len: u64) -> ReplyError {
        let reason = format!("the reply has {len} bytes, but the client accepts at most {max_len}");
        self.explain(reason.into());
        ReplyError::TooLong {
            client: self.client.name.clone(),
            len,
            max_len,
        }
    }

    /// Tells the client that the reply could not be stored, and why.
    fn not_stored(mut self, error: StoreError, needs: Needs) -> ReplyError {
        let reason = format!("{NOT_STORED}: {error}");
        let (call, len) = (self.call, reason.len() as u64);
        // On the ring lane the reason needs a slot as well. A short text may fit into one that is there.
        match self.handle.store(reason.as_bytes().into(), needs) {
            Ok(forms) => {
                self.handle.with(Drive::No, |interface, context| {
                    let body = CallBody::Stored(forms);
                    interface.reply(call, body, len, Status::Failed, context)
                });
                self.answered = true;
            }
            Err(_) => self.explain(NOT_STORED.into()),
        }
        error.into()
    }

    /// Answers the call with this reason in place of a reply.
    fn explain(&mut self, reason: Bytes) {
        let call = self.call;
        self.handle.with(Drive::No, |interface, context| {
            interface.reply_inline(call, reason, Status::Failed, context);
        });
        self.answered = true;
    }

    fn fail(self, reason: &str) -> Result<(), ReplyError> {
        self.reply(reason.as_bytes().into(), Status::Failed)
    }
}

impl Drop for Pending {
    fn drop(&mut self) {
        if self.answered {
            return;
        }
        let call = self.call;
        self.handle.with_driven(|interface, context| {
            let (reason, status) = match interface.is_cancelled(call) {
                true => ("", Status::Cancelled),
                false => (DROPPED, Status::Failed),
            };
            let reason = Bytes::from_static(reason.as_bytes());
            interface.reply_inline(call, reason, status, context);
        });
    }
}

/// Options of a server.
#[derive(Debug)]
#[must_use = "a builder does nothing until declare is called"]
pub struct ServerBuilder<Q: Message + ?Sized, R: Message + ?Sized> {
    declaration: Declaration,
    /// `None`: the types `Q` and `R`.
    types: Option<(TypeId, TypeId)>,
    qos: ServiceQos,
    serves: PhantomData<fn(&Q) -> Box<R>>,
}

impl<Q: Message + ?Sized, R: Message + ?Sized> ServerBuilder<Q, R> {
    pub(crate) fn new(shared: &Arc<SharedNode>, service: &str) -> Self {
        Self {
            declaration: Declaration::new(shared, service),
            types: None,
            qos: ServiceQos {
                depth: 64,
                max_borrowed: 16,
                sealed: false,
            },
            serves: PhantomData,
        }
    }

    /// Sets how many requests of each client wait at this server: 1 to 1,024; 64 by default. Further requests
    /// wait at the client.
    pub const fn depth(mut self, requests: u16) -> Self {
        self.qos.depth = requests;
        self
    }

    /// Sets how many requests of each client the program may hold: 1 to 1,024; 16 by default. Requests
    /// [in cells](crate#how-a-message-travels) do not count.
    pub const fn max_borrowed(mut self, requests: u16) -> Self {
        self.qos.max_borrowed = requests;
        self
    }

    sealed_setter!(
        qos,
        "Seals every request and reply: no process can change it after it is sent."
    );
    inline_max_setter!("Replies");
    max_len_setter!(
        "request",
        "A client sends no longer one: its call fails with
[`CallError::TooLong`](crate::CallError::TooLong) (SM2-SRV-006)."
    );
    wait_setter!("a request");

    /// Declares the server, and waits for the Manager's answer.
    ///
    /// # Errors
    ///
    /// See [`DeclareError`].
    pub fn declare(self) -> Result<Server<Q, R>, DeclareError> {
        // The program has no text for types unknown at compile time.
        let schemas = match self.types {
            None => vec![schema_of::<Q>(), schema_of::<R>()],
            Some(_) => Vec::new(),
        };
        let types = self.types.unwrap_or_else(|| (Q::type_id(), R::type_id()));
        let contract = Contract::Server {
            service: self.declaration.checked_name(Kind::Server)?,
            request: types.0,
            reply: types.1,
            qos: self.qos,
        };
        let handle = self
            .declaration
            .declare(contract, PoolLimit::NONE, schemas)?;
        Ok(Server {
            handle: Arc::new(handle),
            serves: PhantomData,
        })
    }
}

impl ServerBuilder<[u8], [u8]> {
    /// Sets the types of requests and replies, which are passed as bytes: for tools that handle types unknown
    /// at compile time.
    pub fn type_ids(mut self, request: TypeId, reply: TypeId) -> Self {
        self.types = Some((request, reply));
        self
    }
}
