//! The state that all handles of a node share.

use std::io;
use std::path::PathBuf;
use std::sync::{Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use sm2_io::{Epoll, Interest, SeqPacket};
use sm2_proto::node::Input;
use sm2_proto::{Farewell, InterfaceId, Name};

use super::context::Context;
use super::datagram::Incoming;
use super::inner::Inner;
use super::interface::Interface;
use super::sleepers::EventSource;
use super::token::SESSION;
use crate::quota::MappingQuota;

/// The state that all handles of a node share.
#[derive(Debug)]
pub(crate) struct SharedNode {
    pub(crate) epoll: Epoll,
    pub(crate) name: Name,
    /// The timeout for an answer of the Manager.
    pub(crate) manager_timeout: Duration,
    inner: Mutex<Inner>,
    /// The last field, so that the Manager is dropped after this node has closed its session.
    #[cfg(feature = "embedded-manager")]
    embedded: Option<sm2_manager::Background>,
}

impl SharedNode {
    /// Creates a node whose Manager is at the other end of `socket`. The node finds later Managers
    /// at `path`.
    pub(crate) fn new(
        socket: SeqPacket,
        path: PathBuf,
        name: Name,
        manager_timeout: Duration,
        ring_lane: bool,
        mappings: MappingQuota,
    ) -> io::Result<Self> {
        let epoll = Epoll::new()?;
        epoll.add(&socket, SESSION, Interest::READABLE)?;
        let mut inner = Inner::new(socket, path, name.clone(), ring_lane, mappings, &epoll)?;
        inner.state_links();
        inner.drain_session(Incoming::default(), &epoll);
        Ok(Self {
            epoll,
            name,
            manager_timeout,
            inner: Mutex::new(inner),
            #[cfg(feature = "embedded-manager")]
            embedded: None,
        })
    }

    /// Attaches a Manager that runs in this process, active or standby.
    #[cfg(feature = "embedded-manager")]
    pub(crate) fn with_manager(mut self, manager: Option<sm2_manager::Background>) -> Self {
        self.embedded = manager;
        self
    }

    /// Locks the node. If another thread panicked under the lock, the state is still consistent:
    /// the only user code that runs under the lock is a `tracing` subscriber, which must not call
    /// this node.
    #[inline]
    pub(crate) fn lock(&self) -> MutexGuard<'_, Inner> {
        self.inner.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Locks the node and drives it.
    pub(crate) fn lock_driven(&self) -> MutexGuard<'_, Inner> {
        let mut inner = self.lock();
        inner.drive(&self.epoll);
        inner
    }

    /// Drives the node and changes one of its interfaces. `None` if the interface does not exist
    /// any more.
    pub(crate) fn with_driven<R>(
        &self,
        interface: InterfaceId,
        change: impl FnOnce(&mut Interface, &mut Context<'_>) -> R,
    ) -> Option<R> {
        self.lock_driven()
            .with_interface(interface, &self.epoll, change)
    }

    /// The same as [`with_driven`](Self::with_driven), but while all links of the interface have rings, the node
    /// is driven only if its last drive was some time ago.
    #[inline]
    pub(crate) fn with_driven_if_due<R>(
        &self,
        interface: InterfaceId,
        change: impl FnOnce(&mut Interface, &mut Context<'_>) -> R,
    ) -> Option<R> {
        let now = sm2_io::clock::now();
        let mut inner = self.lock();
        let driven = inner.drive_if_due(now, &self.epoll);
        if !driven && !inner.has_rings_only(EventSource::Interface(interface)) {
            inner.drive(&self.epoll);
        }
        inner.with_interface(interface, &self.epoll, change)
    }

    /// The same as [`with_driven`](Self::with_driven), but without driving the node.
    #[inline]
    pub(crate) fn with_undriven<R>(
        &self,
        interface: InterfaceId,
        change: impl FnOnce(&mut Interface, &mut Context<'_>) -> R,
    ) -> Option<R> {
        self.lock().with_interface(interface, &self.epoll, change)
    }
}

impl Drop for SharedNode {
    fn drop(&mut self) {
        let inner = self.inner.get_mut().unwrap_or_else(PoisonError::into_inner);
        inner.session.tell(Input::Close(Farewell::Done.code()));
        inner.drain_session(Incoming::default(), &self.epoll);
    }
}
