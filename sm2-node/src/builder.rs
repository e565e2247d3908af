//! Connecting a node to its Manager.

use std::io;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Duration;

use sm2_io::{SeqPacket, socket_path};
use sm2_proto::{Instant, Name, Refusal};

use crate::driver::{Settings, SharedNode, WaitFailure, may_return};
use crate::quota::MappingQuota;
use crate::{ConnectError, Node, Shutdown};

/// How long to retry a socket that no process listens on: its Manager has just ended, and another one may be
/// taking over.
const SUCCESSION: Duration = Duration::from_millis(250);

/// The default of [`NodeBuilder::max_mapped_bytes`], in bytes: less than a hundredth of the addresses of a process.
pub const MAX_MAPPED_BYTES: u64 = 1 << 40;

/// Options for connecting a node.
#[derive(Clone, Debug)]
#[must_use = "a builder does nothing until connect is called"]
pub struct NodeBuilder {
    name: String,
    domain: Option<String>,
    socket: Option<PathBuf>,
    manager_timeout: Duration,
    startup_timeout: Duration,
    ring_lane: bool,
    background: bool,
    max_mapped_bytes: u64,
    shutdown: Option<Shutdown>,
    #[cfg(feature = "embedded-manager")]
    embedded: Option<sm2_manager::Options>,
}

impl Node {
    /// Connects a node to the domain that the environment names (SM2-TRN-001).
    ///
    /// # Errors
    ///
    /// See [`ConnectError`]; a common one is [`ConnectError::NoManager`].
    pub fn new(name: &str) -> Result<Self, ConnectError> {
        Self::builder(name).connect()
    }

    /// Returns a builder, to choose a domain, a socket or timeouts.
    pub fn builder(name: &str) -> NodeBuilder {
        NodeBuilder::new(name)
    }
}

impl NodeBuilder {
    pub(crate) fn new(name: &str) -> Self {
        Self {
            name: name.to_owned(),
            domain: None,
            socket: None,
            manager_timeout: Duration::from_secs(5),
            startup_timeout: Duration::ZERO,
            ring_lane: is_on("SM2_RING_LANE"),
            background: is_on("SM2_BACKGROUND"),
            max_mapped_bytes: MAX_MAPPED_BYTES,
            shutdown: None,
            #[cfg(feature = "embedded-manager")]
            embedded: None,
        }
    }

    /// Sets the domain (SM2-TRN-002). `SM2_SOCKET` and `SM2_DOMAIN` are ignored.
    pub fn domain(mut self, domain: &str) -> Self {
        self.domain = Some(domain.to_owned());
        self
    }

    /// Sets the path of the Manager's socket. Domain and environment are ignored.
    pub fn socket(mut self, path: impl Into<PathBuf>) -> Self {
        self.socket = Some(path.into());
        self
    }

    /// Sets how long the Manager may take to answer [`connect`](Self::connect), each declaration and each
    /// query; 5 s by default. This includes the time until another Manager has taken over.
    pub const fn manager_timeout(mut self, timeout: Duration) -> Self {
        self.manager_timeout = timeout;
        self
    }

    /// Sets how long [`connect`](Self::connect) waits for a Manager to start if none is running. By default
    /// `Duration::ZERO`: no waiting.
    pub const fn startup_timeout(mut self, timeout: Duration) -> Self {
        self.startup_timeout = timeout;
        self
    }

    /// Sets whether links may use the ring lane if the other side offers it too; `true` by default, unless
    /// the environment has `SM2_RING_LANE=off`. Without the ring lane, every message takes a system call on
    /// each side, which tools such as `strace` can show.
    pub const fn ring_lane(mut self, offered: bool) -> Self {
        self.ring_lane = offered;
        self
    }

    /// Sets whether a thread of the node drives its control side: the session with the Manager, new and ended links,
    /// and messages that wait in this process. `true` by default, unless the environment has `SM2_BACKGROUND=off`.
    ///
    /// The thread sleeps until one of these needs work. No message that a call of the program sends or takes wakes
    /// it. Without the thread, every call drives the whole node. A program that rarely calls the node must then poll
    /// the node's [descriptor](Node#impl-AsFd-for-Node) in an event loop of its own, or call [`Node::spin_for`].
    pub const fn background(mut self, enabled: bool) -> Self {
        self.background = enabled;
        self
    }

    /// Sets how many bytes this node maps for other nodes, to read the messages of their segments and
    /// sealed files: 1 TiB by default. The mappings of one node take at most as many bytes as are free, so
    /// that there is always room for others. A link whose other side exceeds this ends with the code
    /// `resources`; other links go on (SM2-SEG-006).
    ///
    /// All nodes of a process share one bound as well: the greatest one of its nodes.
    ///
    /// The bound is about addresses, not memory: files may be sparse.
    pub const fn max_mapped_bytes(mut self, bytes: u64) -> Self {
        self.max_mapped_bytes = bytes;
        self
    }

    /// Sets a handle that ends every wait of the node: see [`Shutdown`].
    pub fn shutdown(mut self, shutdown: &Shutdown) -> Self {
        self.shutdown = Some(shutdown.clone());
        self
    }

    /// Ensures that the domain has a Manager. If none is running, this process runs one on a thread of its
    /// own; otherwise that thread stands by. The thread lives as long as the node.
    #[cfg(feature = "embedded-manager")]
    pub fn embed_manager(mut self, options: sm2_manager::Options) -> Self {
        self.embedded = Some(options);
        self
    }

    /// Connects to the Manager and sends HELLO.
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
        #[cfg(feature = "embedded-manager")]
        let embedded = match self.embedded {
            Some(options) => Some(sm2_manager::Background::start_or_stand_by(&path, options)?),
            None => None,
        };
        let socket = connect(&path, self.manager_timeout, self.startup_timeout)?;
        let failed = |source| ConnectError::Io {
            path: path.clone(),
            source,
        };
        let settings = Settings {
            manager_timeout: self.manager_timeout,
            ring_lane: self.ring_lane,
            background: self.background,
            mappings: MappingQuota::new(self.max_mapped_bytes),
            shutdown: self.shutdown,
        };
        let mut shared =
            SharedNode::new(socket, path.clone(), name.clone(), settings).map_err(failed)?;
        let until = sm2_io::clock::now().after(self.manager_timeout);
        let answer = shared.wait(Some(until), |control| {
            if let Some(reason) = control.greeting_refusal() {
                return Some(Err(match reason {
                    Refusal::NameTaken => ConnectError::NameTaken { name: name.clone() },
                    reason => ConnectError::Refused(reason.clone()),
                }));
            }
            if control.is_connected() {
                return Some(Ok(()));
            }
            // A Manager that is being replaced may close a new connection, and any Manager does so if HELLO comes too
            // late. The node then connects again.
            let end = control.away().filter(|end| !may_return(*end))?;
            Some(Err(ConnectError::Ended(end)))
        });
        let answer = answer.map_err(|failure| match failure {
            WaitFailure::Shutdown => ConnectError::Shutdown,
            WaitFailure::Io(error) => failed(error),
        });
        match answer? {
            Some(Ok(())) => {
                (shared.start_background()).map_err(ConnectError::BackgroundThread)?;
                #[cfg(feature = "embedded-manager")]
                let shared = shared.with_manager(embedded);
                Ok(Node {
                    shared: Arc::new(shared),
                })
            }
            Some(Err(error)) => Err(error),
            None => Err(match shared.lock().away() {
                Some(end) => ConnectError::Ended(end),
                None => ConnectError::TimedOut { path },
            }),
        }
    }
}

/// Whether a variable of the environment leaves an option on.
fn is_on(variable: &str) -> bool {
    std::env::var_os(variable).is_none_or(|it| it != "off")
}

/// Connects. Retries for `manager_timeout` if the Manager is busy, and for `startup_timeout` if there is
/// none.
fn connect(
    path: &Path,
    manager_timeout: Duration,
    startup_timeout: Duration,
) -> Result<SeqPacket, ConnectError> {
    let now = sm2_io::clock::now();
    loop {
        let source = match SeqPacket::connect(path) {
            Ok(socket) => return Ok(socket),
            Err(error) => error,
        };
        let path = path.to_owned();
        let (until, late) = match source.kind() {
            io::ErrorKind::WouldBlock => {
                (now.after(manager_timeout), ConnectError::TimedOut { path })
            }
            io::ErrorKind::NotFound => (
                now.after(startup_timeout),
                ConnectError::NoManager { path, source },
            ),
            io::ErrorKind::ConnectionRefused => {
                let until = now.after(startup_timeout.max(SUCCESSION));
                (until, ConnectError::NoManager { path, source })
            }
            _ => return Err(ConnectError::Io { path, source }),
        };
        let now: Instant = sm2_io::clock::now();
        if now >= until {
            return Err(late);
        }
        std::thread::sleep(Duration::from_millis(2));
    }
}
