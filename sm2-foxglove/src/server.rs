//! The server: accepts viewers, and follows the domain for all of them.

use std::{
    io,
    net::{self, SocketAddr, TcpListener, TcpStream},
    os::fd::{AsFd, BorrowedFd},
    sync::{Arc, Weak},
    thread::{self, JoinHandle},
    time::Duration,
};

use sm2_node::{
    Node, Shutdown, WaitError, WaitSet,
    domain::{QueryError, Watch},
    wait_set::Interest,
};
use sm2_proto::gateway::Pattern;

use crate::{
    access::Access, catalogue::Catalogue, news::News, options::Options, shared::Shared, viewer,
};

/// The most connections at a time.
const VIEWERS_MAX: usize = 32;

/// The pause before a Manager that did not answer is asked again.
const RETRY: Duration = Duration::from_secs(1);

/// The pause after a connection that cannot be accepted.
const SHORTAGE_PAUSE: Duration = Duration::from_millis(100);

/// The reason why a server cannot start, or go on.
#[derive(Debug, thiserror::Error)]
pub enum ServerError {
    /// The address cannot be used.
    #[error(
        "cannot listen on {address}: {source}; another port may be free (--listen 127.0.0.1:0)"
    )]
    Listen {
        /// The address.
        address: SocketAddr,
        /// The error of the operating system.
        r#source: io::Error,
    },
    /// The domain cannot be followed.
    #[error("cannot follow the domain: {0}")]
    Query(QueryError),
    /// The operating system refuses something that the server needs.
    #[error("the operating system refuses a resource: {0}")]
    System(io::Error),
}

impl From<QueryError> for ServerError {
    fn from(error: QueryError) -> Self {
        Self::Query(error)
    }
}

impl From<io::Error> for ServerError {
    fn from(error: io::Error) -> Self {
        Self::System(error)
    }
}

/// A server of the Foxglove WebSocket protocol.
///
/// It listens from [`start`](Self::start) on, and serves viewers during [`run`](Self::run). Each viewer has a thread.
pub struct Server {
    shared: Arc<Shared>,
    listener: Arc<TcpListener>,
    watch: Watch,
    catalogue: Catalogue,
}

/// The sources that wake the thread of the server.
#[derive(Clone, Copy)]
enum Source {
    Listener,
    Domain,
}

/// A connection and its thread.
struct Connected {
    /// The thread owns the socket, which is closed when the thread ends.
    tcp: Weak<TcpStream>,
    thread: JoinHandle<()>,
}

impl Server {
    /// Listens, and reads the domain of `node`, which should have no other purpose: its interfaces are not shown.
    ///
    /// # Errors
    ///
    /// See [`ServerError`].
    pub fn start(node: &Node, options: Options) -> Result<Self, ServerError> {
        let address = options.listen;
        let failed = |source| ServerError::Listen { address, source };
        let listener = TcpListener::bind(address).map_err(failed)?;
        listener.set_nonblocking(true)?;
        let access = Access::new(listener.local_addr()?, &options.allow_origins)?;
        let mut watch = node.watch();
        watch.wait()?;
        let mut catalogue = Catalogue::new(node, options.topics.clone());
        catalogue.update(watch.domain())?;
        let news = News::default();
        news.publish(catalogue.snapshot().clone());
        let shared = Arc::new(Shared {
            node: node.clone(),
            access,
            options,
            news,
            name: format!("SM2 {}", node.name()),
            session: format!("{:x}", sm2_node::clock::wall_time().0),
        });
        Ok(Self {
            shared,
            listener: Arc::new(listener),
            watch,
            catalogue,
        })
    }

    /// The URL to open in a viewer. It has the token of this server.
    #[must_use]
    pub fn url(&self) -> String {
        self.shared.access.url()
    }

    /// The patterns of [`Options::topics`] that no topic of the domain matches now.
    pub fn unmatched(&self) -> impl Iterator<Item = &Pattern> {
        self.catalogue.unmatched()
    }

    /// Serves viewers until `shutdown` is requested.
    ///
    /// # Errors
    ///
    /// See [`ServerError`].
    pub fn run(&mut self, shutdown: &Shutdown) -> Result<(), ServerError> {
        let mut viewers = Vec::new();
        let result = match self.serve(shutdown, &mut viewers) {
            // The node may use the same shutdown.
            Err(ServerError::Query(QueryError::Shutdown)) => Ok(()),
            result => result,
        };
        shutdown.request();
        for Connected { tcp, thread } in viewers {
            // Ends a handshake. The threads of other viewers end by the shutdown.
            let _ = tcp.upgrade().map(|it| it.shutdown(net::Shutdown::Read));
            // A thread that has panicked has reported it.
            let _ = thread.join();
        }
        result
    }

    fn serve(
        &mut self,
        shutdown: &Shutdown,
        viewers: &mut Vec<Connected>,
    ) -> Result<(), ServerError> {
        let mut set = WaitSet::new()?;
        set.end_with(shutdown)?;
        let listener = Listener(Arc::clone(&self.listener));
        set.add_descriptor(listener, Interest::Readable, Source::Listener)?;
        set.add_watch(&mut self.watch, Source::Domain)?;
        let mut is_current = true;
        loop {
            let ready = match is_current {
                true => set.wait().map(Some),
                false => set.wait_timeout(RETRY),
            };
            match ready {
                Ok(Some(ready)) => match ready.tag {
                    Source::Listener => self.accept(shutdown, viewers),
                    Source::Domain => is_current &= self.watch.try_wait()?.is_empty(),
                },
                Ok(None) => {}
                Err(WaitError::Shutdown) => return Ok(()),
                Err(WaitError::Io(error)) => return Err(error.into()),
                Err(other) => return Err(io::Error::other(other).into()),
            }
            if !is_current {
                is_current = self.look()?;
            }
        }
    }

    /// Shows the changes of the domain to all viewers. Returns `false` if the Manager has not answered.
    fn look(&mut self) -> Result<bool, ServerError> {
        match self.catalogue.update(self.watch.domain()) {
            Ok(()) => {
                self.shared.news.publish(self.catalogue.snapshot().clone());
                Ok(true)
            }
            Err(QueryError::TimedOut | QueryError::ManagerGone(_)) => Ok(false),
            Err(error) => Err(error.into()),
        }
    }

    fn accept(&self, shutdown: &Shutdown, viewers: &mut Vec<Connected>) {
        viewers.retain(|it| !it.thread.is_finished());
        let (tcp, address) = match self.listener.accept() {
            Ok(accepted) => accepted,
            // The client has gone.
            Err(error) if error.kind() == io::ErrorKind::WouldBlock => return,
            Err(error) => {
                // Such as a lack of descriptors. The client still waits, so the next wait ends at once.
                tracing::warn!(%error, "cannot accept a connection");
                return thread::sleep(SHORTAGE_PAUSE);
            }
        };
        if viewers.len() >= VIEWERS_MAX {
            tracing::warn!(%address, "refused: there are {VIEWERS_MAX} connections");
            return;
        }
        match self.spawn(shutdown, tcp, address) {
            Ok(connected) => viewers.push(connected),
            Err(error) => tracing::warn!(%address, %error, "cannot serve a viewer"),
        }
    }

    fn spawn(
        &self,
        shutdown: &Shutdown,
        tcp: TcpStream,
        address: SocketAddr,
    ) -> io::Result<Connected> {
        tcp.set_nonblocking(false)?;
        let tcp = Arc::new(tcp);
        let weak = Arc::downgrade(&tcp);
        let (shared, shutdown) = (Arc::clone(&self.shared), shutdown.clone());
        let thread = thread::Builder::new()
            .name("viewer".to_owned())
            .spawn(move || {
                let end = viewer::serve(&shared, tcp, &shutdown);
                tracing::info!(%address, "a viewer has gone: {end}");
            })?;
        Ok(Connected { tcp: weak, thread })
    }
}

/// The listener, which the wait set and the server share.
struct Listener(Arc<TcpListener>);

impl AsFd for Listener {
    fn as_fd(&self) -> BorrowedFd<'_> {
        self.0.as_fd()
    }
}
