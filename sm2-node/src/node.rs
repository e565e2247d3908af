//! A node: one session with the Manager of one domain.

use std::io;
use std::os::fd::{AsFd, BorrowedFd};
use std::sync::Arc;
use std::time::Duration;

use sm2_proto::{Instant, Name, NodeId};

use crate::driver::{Shared, Topic};
use crate::handle::until;
use crate::{
    Client, ClientBuilder, DeclareError, Message, Publisher, PublisherBuilder, Server,
    ServerBuilder, Subscriber, SubscriberBuilder, WaitError,
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
/// # When the Manager goes
///
/// The end of the session (the Manager was stopped, or died) ends no link: messages go on
/// to flow (SM2-NOD-003). The node connects again by itself, as soon as there is another
/// Manager, and brings along what it has (SM2-RES-001): interfaces, links, counters. Until
/// then nothing new is linked, what is declared waits for the new Manager as long as
/// [`NodeBuilder::manager_timeout`](crate::NodeBuilder::manager_timeout) says, and waiting without a time-out goes on. Whatever moves the node
/// on does this as well; for others, the node's [descriptor](AsFd) wakes them.
///
/// What `tracing` is told, is told while the node is locked: a `tracing` subscriber must not
/// call the node in turn.
#[derive(Clone, Debug)]
pub struct Node {
    pub(crate) shared: Arc<Shared>,
}

impl Node {
    /// The node's name.
    #[must_use]
    pub fn name(&self) -> &Name {
        &self.shared.name
    }

    /// Whether there is a Manager that knows all of this node, as far as is known now.
    #[must_use]
    pub fn is_connected(&self) -> bool {
        self.shared.driven().is_connected()
    }

    /// Waits until a Manager knows all of this node, without a time limit.
    ///
    /// # Errors
    ///
    /// [`WaitError::Io`].
    pub fn wait_connected(&self) -> Result<(), WaitError> {
        self.wait_connected_until(None)
    }

    /// Waits until a Manager knows all of this node, for at most `timeout`.
    ///
    /// # Errors
    ///
    /// [`WaitError::NoManager`] when the time is over, [`WaitError::Io`].
    pub fn wait_connected_timeout(&self, timeout: Duration) -> Result<(), WaitError> {
        self.wait_connected_until(Some(timeout))
    }

    fn wait_connected_until(&self, timeout: Option<Duration>) -> Result<(), WaitError> {
        let connected = self.shared.wait(Topic::Session, until(timeout), |inner| {
            inner.is_connected().then_some(())
        });
        match connected.map_err(WaitError::Io)? {
            Some(()) => Ok(()),
            None => Err(WaitError::NoManager {
                end: self.shared.lock().away(),
            }),
        }
    }

    /// The incarnation of the Manager, which no other has; `None` as long as there is no
    /// Manager (SM2-SES-007).
    #[must_use]
    pub fn epoch(&self) -> Option<u64> {
        self.shared.driven().epoch()
    }

    /// The number by which the Manager of the moment knows this node; `None` as long as there
    /// is no Manager. Another Manager gives another number.
    #[must_use]
    pub fn id(&self) -> Option<NodeId> {
        self.shared.driven().node_id()
    }

    /// A publisher with the default quality of service: keep-last, 8 messages for each
    /// subscriber.
    ///
    /// Topics and services are named as SM2-NAM-001 says: segments of `A-Z a-z 0-9 _ -`, joined by
    /// single `/`. One `/` before the first is accepted here and left out: `/scan` is `scan`.
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
    /// Names are written as for [`publisher`](Self::publisher).
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
    /// Names are written as for [`publisher`](Self::publisher).
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
    /// Names are written as for [`publisher`](Self::publisher).
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

    /// Moves the node on, for ever.
    ///
    /// # Errors
    ///
    /// Whatever the operating system says when it cannot wait.
    pub fn spin(&self) -> io::Result<()> {
        self.spin_until(None)
    }

    /// Moves the node on for this long.
    ///
    /// # Errors
    ///
    /// As [`spin`](Self::spin).
    pub fn spin_for(&self, duration: Duration) -> io::Result<()> {
        self.spin_until(until(Some(duration)))
    }

    /// Moves the node on as far as possible, and never waits.
    ///
    /// # Errors
    ///
    /// As [`spin`](Self::spin).
    pub fn spin_some(&self) -> io::Result<()> {
        drop(self.shared.driven());
        Ok(())
    }

    /// Waits until the node has something to do, without a time limit, and then moves it on as
    /// [`spin_some`](Self::spin_some) does. The node's [descriptor](AsFd) is readable at that
    /// moment.
    ///
    /// # Errors
    ///
    /// As [`spin`](Self::spin).
    pub fn spin_once(&self) -> io::Result<()> {
        self.spin_once_until(None)
    }

    /// As [`spin_once`](Self::spin_once), but waits for at most `timeout`.
    ///
    /// # Errors
    ///
    /// As [`spin`](Self::spin).
    pub fn spin_once_timeout(&self, timeout: Duration) -> io::Result<()> {
        self.spin_once_until(Some(timeout))
    }

    fn spin_once_until(&self, timeout: Option<Duration>) -> io::Result<()> {
        // A message in a ring is work too, but for its subscriber: it only ends the waiting.
        if !self.shared.lock().park_all() {
            sm2_io::wait_readable(&[self.shared.epoll.as_fd()], timeout)?;
        }
        self.spin_some()
    }

    fn spin_until(&self, until: Option<Instant>) -> io::Result<()> {
        let nothing = |_: &mut _| None::<()>;
        self.shared.wait(Topic::Session, until, nothing).map(drop)
    }
}

/// Readable when [`Node::spin_once`] has something to do. To learn about messages, poll the
/// descriptor of the subscriber, server or client.
impl AsFd for Node {
    fn as_fd(&self) -> BorrowedFd<'_> {
        self.shared.epoll.as_fd()
    }
}
