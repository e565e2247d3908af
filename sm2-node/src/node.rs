//! A node: one session with the Manager of one domain.

use std::io;
use std::os::fd::{AsFd, BorrowedFd};
use std::path::PathBuf;
use std::sync::{Arc, PoisonError};
use std::time::Duration;

use sm2_io::{SeqPacket, socket_path};
use sm2_proto::control::{Cursor, Item};
use sm2_proto::{Instant, Name, Refusal};

use crate::driver::{Greeting, Shared, Topic};
use crate::handle::until;
use crate::{
    Client, ClientBuilder, ConnectError, DeclareError, Message, Publisher, PublisherBuilder,
    QueryError, Server, ServerBuilder, Subscriber, SubscriberBuilder,
};

/// A node, known to its domain by its name.
///
/// Cloning it makes another handle of the same node. The session lives as long as any handle,
/// or a publisher, subscriber, server or client of it. All handles can be used from
/// several threads at a time: while one waits, others go on.
///
/// There is no hidden thread: whatever is called moves all of the node's sockets on, as
/// far as that is possible without waiting. A program that calls rarely, while others
/// depend on it, calls [`spin`](Self::spin) in between: a subscriber that joins late is
/// only served by a publisher that is called.
///
/// The end of the session (the Manager was stopped, or died) ends no link: messages go on
/// to flow, and only new interfaces and new links are not possible any more (SM2-NOD-003).
#[derive(Clone, Debug)]
pub struct Node {
    shared: Arc<Shared>,
}

impl Node {
    /// A node in the domain that the environment names (SM2-TRN-001).
    ///
    /// # Errors
    ///
    /// See [`ConnectError`]; a common one is [`ConnectError::NoManager`].
    pub fn new(name: &str) -> Result<Self, ConnectError> {
        Self::builder(name).connect()
    }

    /// To choose a domain, a socket, or how long to wait for the Manager.
    pub fn builder(name: &str) -> NodeBuilder {
        NodeBuilder {
            name: name.to_owned(),
            domain: None,
            socket: None,
            timeout: Duration::from_secs(5),
        }
    }

    /// The node's name.
    #[must_use]
    pub fn name(&self) -> &Name {
        &self.shared.name
    }

    /// Whether the session with the Manager lives, as far as is known now.
    #[must_use]
    pub fn is_connected(&self) -> bool {
        self.shared.driven().session_end().is_none()
    }

    /// A publisher with the default quality of service: keep-last, 8 messages for each
    /// subscriber.
    ///
    /// # Errors
    ///
    /// See [`DeclareError`].
    pub fn publisher<T: Message + ?Sized>(
        &self,
        topic: &str,
    ) -> Result<Publisher<T>, DeclareError> {
        self.publisher_builder(topic).declare()
    }

    /// To choose a publisher's quality of service.
    pub fn publisher_builder<T: Message + ?Sized>(&self, topic: &str) -> PublisherBuilder<T> {
        PublisherBuilder::new(&self.shared, topic)
    }

    /// A subscriber with the default quality of service: keep-last, 8 messages of each
    /// publisher.
    ///
    /// # Errors
    ///
    /// See [`DeclareError`].
    pub fn subscriber<T: Message + ?Sized>(
        &self,
        topic: &str,
    ) -> Result<Subscriber<T>, DeclareError> {
        self.subscriber_builder(topic).declare()
    }

    /// To choose a subscriber's quality of service.
    pub fn subscriber_builder<T: Message + ?Sized>(&self, topic: &str) -> SubscriberBuilder<T> {
        SubscriberBuilder::new(&self.shared, topic)
    }

    /// A server that answers requests of type `Q` with replies of type `R`.
    ///
    /// # Errors
    ///
    /// See [`DeclareError`].
    pub fn server<Q, R>(&self, service: &str) -> Result<Server<Q, R>, DeclareError>
    where
        Q: Message + ?Sized,
        R: Message + ?Sized,
    {
        self.server_builder(service).declare()
    }

    /// To choose a server's limits.
    pub fn server_builder<Q, R>(&self, service: &str) -> ServerBuilder<Q, R>
    where
        Q: Message + ?Sized,
        R: Message + ?Sized,
    {
        ServerBuilder::new(&self.shared, service)
    }

    /// A client that sends requests of type `Q` and gets replies of type `R`.
    ///
    /// # Errors
    ///
    /// See [`DeclareError`].
    pub fn client<Q, R>(&self, service: &str) -> Result<Client<Q, R>, DeclareError>
    where
        Q: Message + ?Sized,
        R: Message + ?Sized,
    {
        self.client_builder(service).declare()
    }

    /// To choose a client's limits.
    pub fn client_builder<Q, R>(&self, service: &str) -> ClientBuilder<Q, R>
    where
        Q: Message + ?Sized,
        R: Message + ?Sized,
    {
        ClientBuilder::new(&self.shared, service)
    }

    /// Moves the node on, for ever: until the session with the Manager is over and no link is left.
    ///
    /// # Errors
    ///
    /// Whatever the operating system says when it cannot wait.
    pub fn spin(&self) -> io::Result<()> {
        self.spin_until(None)
    }

    /// Moves the node on for this long, or until there is nothing left to move.
    ///
    /// # Errors
    ///
    /// As [`spin`](Self::spin).
    pub fn spin_for(&self, duration: Duration) -> io::Result<()> {
        self.spin_until(until(Some(duration)))
    }

    /// Moves the node on once, as far as is possible without waiting. With a timeout it
    /// first waits that long for something to do; the node's [descriptor](AsFd) is readable when
    /// there is.
    ///
    /// # Errors
    ///
    /// As [`spin`](Self::spin).
    pub fn spin_once(&self, timeout: Option<Duration>) -> io::Result<()> {
        if let Some(timeout) = timeout {
            sm2_io::wait_readable(&[self.shared.epoll.as_fd()], Some(timeout))?;
        }
        drop(self.shared.driven());
        Ok(())
    }

    fn spin_until(&self, until: Option<Instant>) -> io::Result<()> {
        let idle = self.shared.wait(Topic::Session, until, |inner| {
            inner.session_end()?;
            let mut links = inner.interfaces.values().flat_map(|it| it.links());
            links.all(|link| link.end().is_some()).then_some(())
        });
        idle.map(drop)
    }

    /// All nodes and interfaces of the domain, at one moment (SM2-IFC-007).
    ///
    /// # Errors
    ///
    /// See [`QueryError`].
    pub fn graph(&self, timeout: Duration) -> Result<Graph, QueryError> {
        let shared = &self.shared;
        let _turn = shared
            .querying
            .lock()
            .unwrap_or_else(PoisonError::into_inner);
        let until = until(Some(timeout));
        loop {
            let mut graph = Graph {
                revision: 0,
                items: Vec::new(),
            };
            let mut after = None;
            loop {
                let page = self.page(after, until)?;
                let consistent = graph.items.is_empty() || graph.revision == page.revision;
                if !consistent {
                    // It changed between two pages: start again.
                    break;
                }
                graph.revision = page.revision;
                graph.items.extend(page.items);
                after = page.next;
                if after.is_none() {
                    return Ok(graph);
                }
            }
        }
    }

    fn page(
        &self,
        after: Option<Cursor>,
        until: Option<Instant>,
    ) -> Result<crate::driver::Page, QueryError> {
        let shared = &self.shared;
        shared.lock().query(after, &shared.epoll);
        let page = shared.wait(Topic::Session, until, |inner| {
            let page = inner.take_page().map(Ok);
            page.or_else(|| inner.session_end().map(Err))
        });
        match page.map_err(QueryError::Io)? {
            Some(Ok(page)) => Ok(page),
            Some(Err(end)) => Err(QueryError::ManagerGone(end)),
            None => Err(QueryError::TimedOut),
        }
    }
}

/// Readable when [`Node::spin_once`] has something to do. To learn about messages, poll the
/// descriptor of the subscriber, server or client.
impl AsFd for Node {
    fn as_fd(&self) -> BorrowedFd<'_> {
        self.shared.epoll.as_fd()
    }
}

/// A domain at one moment.
#[derive(Clone, Debug)]
pub struct Graph {
    /// The domain's revision: it changes whenever anything here does.
    pub revision: u64,
    /// Nodes, each followed by its interfaces.
    pub items: Vec<Item>,
}

/// Where a node connects, and how long it tries.
#[derive(Clone, Debug)]
#[must_use = "a builder does nothing until connect is called"]
pub struct NodeBuilder {
    name: String,
    domain: Option<String>,
    socket: Option<PathBuf>,
    timeout: Duration,
}

impl NodeBuilder {
    /// The domain of this name (SM2-TRN-002), whatever the environment says.
    pub fn domain(mut self, domain: &str) -> Self {
        self.domain = Some(domain.to_owned());
        self
    }

    /// The Manager's socket itself, whatever domain and environment say.
    pub fn socket(mut self, path: impl Into<PathBuf>) -> Self {
        self.socket = Some(path.into());
        self
    }

    /// How long the Manager may take to answer, here and to each declaration; 5 s by default.
    pub const fn timeout(mut self, timeout: Duration) -> Self {
        self.timeout = timeout;
        self
    }

    /// Connects and greets.
    ///
    /// # Errors
    ///
    /// See [`ConnectError`].
    pub fn connect(self) -> Result<Node, ConnectError> {
        let name = Name::typed(&self.name).map_err(|reason| ConnectError::Name {
            name: self.name,
            reason,
        })?;
        let path = match self.socket {
            Some(path) => path,
            None => socket_path(self.domain.as_deref())?,
        };
        let until = sm2_io::clock::now().after(self.timeout);
        let socket = connect(&path, until)?;
        let failed = |source| ConnectError::Io {
            path: path.clone(),
            source,
        };
        let shared = Shared::new(socket, name.clone(), self.timeout).map_err(failed)?;
        let answer = shared.wait(Topic::Session, Some(until), |inner| {
            match inner.greeting() {
                Greeting::Sent => inner.session_end().map(Err),
                answered => Some(Ok(answered.clone())),
            }
        });
        match answer.map_err(failed)? {
            Some(Ok(Greeting::Welcomed)) => Ok(Node {
                shared: Arc::new(shared),
            }),
            Some(Ok(Greeting::Refused(Refusal::NameTaken))) => {
                Err(ConnectError::NameTaken { name })
            }
            Some(Ok(Greeting::Refused(reason))) => Err(ConnectError::Refused(reason)),
            Some(Err(end)) => Err(ConnectError::Ended(end)),
            Some(Ok(Greeting::Sent)) | None => Err(ConnectError::TimedOut { path }),
        }
    }
}

/// Connects; a Manager that is there but busy is asked again until the time is over.
fn connect(path: &std::path::Path, until: Instant) -> Result<SeqPacket, ConnectError> {
    loop {
        let source = match SeqPacket::connect(path) {
            Ok(socket) => return Ok(socket),
            Err(error) => error,
        };
        let path = path.to_owned();
        match source.kind() {
            io::ErrorKind::WouldBlock if sm2_io::clock::now() < until => {
                std::thread::sleep(Duration::from_millis(2));
            }
            io::ErrorKind::WouldBlock => return Err(ConnectError::TimedOut { path }),
            io::ErrorKind::NotFound | io::ErrorKind::ConnectionRefused => {
                return Err(ConnectError::NoManager { path, source });
            }
            _ => return Err(ConnectError::Io { path, source }),
        }
    }
}
