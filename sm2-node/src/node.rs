//! A node: a session with the Manager of one domain.

use std::io;
use std::os::fd::{AsFd, BorrowedFd};
use std::sync::Arc;
use std::time::Duration;

use sm2_proto::{Instant, Name, NodeId};

use crate::driver::{SharedNode, WaitFailure};
use crate::handle::until;
use crate::{
    Client, ClientBuilder, DeclareError, Message, Publisher, PublisherBuilder, Server,
    ServerBuilder, Subscriber, SubscriberBuilder, WaitError,
};

/// A node of a domain, with a unique name.
///
/// Clones are handles of the same node. The node exists as long as any handle of it, or any of its
/// publishers, subscribers, servers or clients. All handles can be used from several threads at the same
/// time: while one call waits, others continue.
///
/// # Threads
///
/// A background thread of the node does the work of the control side: the session with the Manager, new and ended
/// links, and messages that wait for room. Calls of the program send, take and release messages; they do not wake the
/// thread. Every handle can be used from every thread of the program.
/// [`NodeBuilder::background(false)`](crate::NodeBuilder::background) turns the thread off: every call then drives the
/// whole node, and a program that rarely calls it must call [`spin_for`](Self::spin_for) in between.
/// The [crate's documentation](crate#how-it-runs) describes the thread: its name, signals, priority, and `fork(2)`.
///
/// # When the Manager ends
///
/// When the session ends (the Manager was stopped or has crashed), links stay open and messages continue to
/// flow (SM2-NOD-003). The node connects to the next Manager by itself and brings its interfaces, links and
/// counters along (SM2-RES-001). Until then there are no new links. Declarations wait for the new Manager for
/// at most [`NodeBuilder::manager_timeout`](crate::NodeBuilder::manager_timeout), and calls without a timeout
/// continue to wait. Without a background thread, every call that drives the node also reconnects it; for event
/// loops, the node's [descriptor](AsFd) becomes readable.
///
/// The node is locked while it logs to `tracing`: a `tracing` subscriber must not call the node.
///
/// ```no_run
/// use sm2_node::{Node, Shutdown};
///
/// # fn main() -> Result<(), Box<dyn std::error::Error>> {
/// let shutdown = Shutdown::on_signals()?;     // Ctrl-C ends the waits of the node
/// let node = Node::builder("lidar").shutdown(&shutdown).connect()?;
/// let scans = node.publisher::<[f32]>("scan")?;
/// let server = node.server::<str, u64>("count")?;
/// # Ok(())
/// # }
/// ```
#[derive(Clone, Debug)]
pub struct Node {
    pub(crate) shared: Arc<SharedNode>,
}

impl Node {
    /// Returns the node's name.
    #[must_use]
    pub fn name(&self) -> &Name {
        &self.shared.name
    }

    /// Returns whether the node has a session with a Manager, and that Manager has answered all earlier
    /// declarations of the node.
    #[must_use]
    pub fn is_connected(&self) -> bool {
        self.shared.lock_driven().is_connected()
    }

    /// Waits until [`is_connected`](Self::is_connected), without a time limit.
    ///
    /// # Errors
    ///
    /// [`WaitError::Io`].
    pub fn wait_connected(&self) -> Result<(), WaitError> {
        self.wait_connected_until(None)
    }

    /// Waits until [`is_connected`](Self::is_connected), for at most `timeout`.
    ///
    /// # Errors
    ///
    /// [`WaitError::NoManager`] after the timeout; [`WaitError::Io`].
    pub fn wait_connected_timeout(&self, timeout: Duration) -> Result<(), WaitError> {
        self.wait_connected_until(Some(timeout))
    }

    fn wait_connected_until(&self, timeout: Option<Duration>) -> Result<(), WaitError> {
        let connected = (self.shared).wait(until(timeout), |control| {
            control.is_connected().then_some(())
        });
        match connected? {
            Some(()) => Ok(()),
            None => Err(WaitError::NoManager {
                end: self.shared.lock().away(),
            }),
        }
    }

    /// Returns the epoch of the Manager, which is unique for each Manager; `None` while there is no Manager
    /// (SM2-SES-007).
    #[must_use]
    pub fn epoch(&self) -> Option<u64> {
        self.shared.lock_driven().epoch()
    }

    /// Returns the number of this node at the current Manager; `None` while there is no Manager. Each Manager
    /// assigns new numbers.
    #[must_use]
    pub fn id(&self) -> Option<NodeId> {
        self.shared.lock_driven().node_id()
    }

    /// Declares a publisher with the default quality of service: keep-last, 8 messages for each subscriber.
    ///
    /// Names of topics and services follow SM2-NAM-001: segments of `A-Z a-z 0-9 _ -`, joined by single `/`.
    /// A leading `/` is accepted and removed: `/scan` is `scan`.
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

    /// Returns a builder, to choose a publisher's quality of service.
    pub fn publisher_builder<T: Message + ?Sized>(&self, topic: &str) -> PublisherBuilder<T> {
        PublisherBuilder::new(&self.shared, topic)
    }

    /// Declares a subscriber with the default quality of service: keep-last, 8 messages of each publisher.
    ///
    /// Names follow the rules of [`publisher`](Self::publisher).
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

    /// Returns a builder, to choose a subscriber's quality of service.
    pub fn subscriber_builder<T: Message + ?Sized>(&self, topic: &str) -> SubscriberBuilder<T> {
        SubscriberBuilder::new(&self.shared, topic)
    }

    /// Declares a server that answers requests of type `Q` with replies of type `R`.
    ///
    /// Names follow the rules of [`publisher`](Self::publisher).
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

    /// Returns a builder, to choose a server's limits.
    pub fn server_builder<Q, R>(&self, service: &str) -> ServerBuilder<Q, R>
    where
        Q: Message + ?Sized,
        R: Message + ?Sized,
    {
        ServerBuilder::new(&self.shared, service)
    }

    /// Declares a client that sends requests of type `Q` and gets replies of type `R`.
    ///
    /// Names follow the rules of [`publisher`](Self::publisher).
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

    /// Returns a builder, to choose a client's limits.
    pub fn client_builder<Q, R>(&self, service: &str) -> ClientBuilder<Q, R>
    where
        Q: Message + ?Sized,
        R: Message + ?Sized,
    {
        ClientBuilder::new(&self.shared, service)
    }

    /// Waits forever, and drives the node meanwhile. With a background thread, the node needs no such call.
    ///
    /// # Errors
    ///
    /// An error of the operating system while waiting.
    pub fn spin(&self) -> io::Result<()> {
        self.spin_until(None)
    }

    /// Waits for `duration`, and drives the node meanwhile. With a background thread, the node needs no such call.
    ///
    /// # Errors
    ///
    /// As [`spin`](Self::spin).
    pub fn spin_for(&self, duration: Duration) -> io::Result<()> {
        self.spin_until(until(Some(duration)))
    }

    /// Drives the node as far as possible, without waiting.
    ///
    /// # Errors
    ///
    /// As [`spin`](Self::spin).
    pub fn spin_some(&self) -> io::Result<()> {
        self.shared.drive_all();
        Ok(())
    }

    /// Waits, without a time limit, until a socket or a timer of the node is ready, and then drives the node
    /// as [`spin_some`](Self::spin_some) does.
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
        self.shared.wait_once(timeout)?;
        self.spin_some()
    }

    fn spin_until(&self, until: Option<Instant>) -> io::Result<()> {
        let nothing = |_: &mut _| None::<()>;
        match self.shared.wait(until, nothing) {
            Ok(_) | Err(WaitFailure::Shutdown) => Ok(()),
            Err(WaitFailure::Io(error)) => Err(error),
        }
    }
}

/// Readable when a socket of a link is ready or the session has changed; without a background thread, also when the
/// node has other work to do. Then call [`Node::spin_some`]: another thread may do the work first, so
/// [`Node::spin_once`] might wait. To learn about messages, poll the descriptor of the subscriber, server or client
/// instead.
impl AsFd for Node {
    fn as_fd(&self) -> BorrowedFd<'_> {
        self.shared.sets.as_fd()
    }
}
