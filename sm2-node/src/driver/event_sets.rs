//! The epoll sets of a node and of its interfaces: the descriptors that wake the background thread, and those that
//! wake calls of the program.

use std::io;
use std::os::fd::{AsFd, BorrowedFd};
use std::sync::Arc;
use std::time::Duration;

use sm2_io::{Epoll, Events, Interest, SeqPacket, Waker};
use sm2_proto::InterfaceId;

use super::sleepers::{Sleepers, SpareWakers};
use super::token::{LinkToken, PROGRAM};
use crate::Shutdown;

/// The epoll sets of a node.
///
/// | descriptor | control set | set of its interface | program set |
/// | --- | --- | --- | --- |
/// | session, reconnect timer | readable, writable | | |
/// | link | [`BackgroundInterest`] | readable, writable | |
/// | set of each interface, waker for changes of the session | | | readable |
/// | control set | | | without a background thread |
///
/// The kernel bounds the number of paths of an event to the outermost set (`EINVAL`). The control set is
/// therefore in no set of an interface.
#[derive(Debug)]
pub(crate) struct NodeSets {
    /// The descriptors of the control side.
    pub(super) control: Epoll,
    /// The descriptors for a program that polls the node.
    program: Epoll,
    has_background: bool,
    /// Ends the waits of the program's threads.
    shutdown: Option<Shutdown>,
    /// For the threads that wait for any part of the node.
    pub(super) wakers: Arc<SpareWakers>,
}

/// The epoll sets of the links of one interface.
#[derive(Debug)]
pub(crate) struct LinkSets {
    /// The descriptors that calls of the program read and write.
    pub(super) calls: Epoll,
    pub(super) node: Arc<NodeSets>,
}

/// The events of a link that the control side handles.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum BackgroundInterest {
    /// Only the end of the link: calls read all other packets.
    End,
    /// Every packet: the link is opening, or messages wait for packets of the other side.
    Packets,
    /// The socket accepts packets again, and every packet.
    Room,
}

impl BackgroundInterest {
    const fn events(self) -> Interest {
        match self {
            Self::End => Interest::NONE,
            Self::Packets => Interest::READABLE,
            Self::Room => Interest::BOTH,
        }
    }
}

impl NodeSets {
    /// Creates the sets of a node. Until [`detach_control`](Self::detach_control), the program set has the control
    /// set.
    pub(super) fn new(has_background: bool, shutdown: Option<Shutdown>) -> io::Result<Self> {
        let (control, program) = (Epoll::new()?, Epoll::new()?);
        program.add(&control, PROGRAM, Interest::READABLE)?;
        Ok(Self {
            control,
            program,
            has_background,
            shutdown,
            wakers: Arc::new(SpareWakers::new()?),
        })
    }

    /// Removes the control set from the program set, because the background thread drives the control side.
    pub(super) fn detach_control(&self) -> io::Result<()> {
        self.program.remove(&self.control)
    }

    /// Whether a background thread drives the control side.
    pub(super) const fn has_background(&self) -> bool {
        self.has_background
    }

    /// Whether the program has requested a shutdown.
    #[inline]
    pub(super) fn is_shut_down(&self) -> bool {
        (self.shutdown.as_ref()).is_some_and(Shutdown::is_requested)
    }

    /// The shutdown that ends every wait.
    pub(crate) const fn shutdown_handle(&self) -> Option<&Shutdown> {
        self.shutdown.as_ref()
    }

    /// The descriptor that ends every wait.
    pub(super) fn shutdown(&self) -> Option<BorrowedFd<'_>> {
        self.shutdown.as_ref().map(AsFd::as_fd)
    }

    /// Does not wait. Returns the interfaces whose events the program set reports.
    pub(super) fn ready_interfaces(&self, events: &mut Events) -> io::Result<Vec<InterfaceId>> {
        self.program.wait(events, Some(Duration::ZERO))?;
        let tokens = events.iter().map(|event| event.token);
        Ok(tokens
            .filter(|&it| it != PROGRAM)
            .map(InterfaceId)
            .collect())
    }

    /// Adds the waker that is signalled when the session changes.
    pub(super) fn add_waker(&self, waker: &Waker) -> io::Result<()> {
        self.program.add(waker, PROGRAM, Interest::READABLE)
    }
}

/// The descriptor of a node for programs that poll it.
impl AsFd for NodeSets {
    fn as_fd(&self) -> BorrowedFd<'_> {
        self.program.as_fd()
    }
}

impl LinkSets {
    /// Creates the set of an interface.
    pub(super) fn new(node: &Arc<NodeSets>, interface: InterfaceId) -> io::Result<Self> {
        let calls = Epoll::new()?;
        node.program.add(&calls, interface.0, Interest::READABLE)?;
        Ok(Self {
            calls,
            node: Arc::clone(node),
        })
    }

    /// Whether a background thread drives the control side.
    #[inline]
    pub(super) fn has_background(&self) -> bool {
        self.node.has_background
    }

    /// Whether the program has requested a shutdown.
    #[inline]
    pub(super) fn is_shut_down(&self) -> bool {
        self.node.is_shut_down()
    }

    /// The descriptor that ends every wait.
    pub(super) fn shutdown(&self) -> Option<BorrowedFd<'_>> {
        self.node.shutdown()
    }

    /// The set of the control side.
    pub(super) fn control(&self) -> &Epoll {
        &self.node.control
    }

    /// The threads that wait for the interface: none yet.
    pub(super) fn sleepers(&self) -> Sleepers {
        Sleepers::new(&self.node.wakers)
    }

    /// Watches the socket of a new link.
    pub(super) fn add_link(&self, socket: &SeqPacket, token: LinkToken) -> io::Result<()> {
        self.calls.add(socket, token.0, Interest::READABLE)?;
        let interest = BackgroundInterest::Packets.events();
        (self.node.control.add(socket, token.0, interest)).inspect_err(|_| self.remove_link(socket))
    }

    /// Changes the events of a link that wake calls.
    pub(super) fn watch_link(
        &self,
        socket: &SeqPacket,
        token: LinkToken,
        interest: Interest,
    ) -> io::Result<()> {
        self.calls.modify(socket, token.0, interest)
    }

    /// Changes the events of a link that the control side handles.
    pub(super) fn watch_link_in_background(
        &self,
        socket: &SeqPacket,
        token: LinkToken,
        interest: BackgroundInterest,
    ) -> io::Result<()> {
        (self.node.control).modify(socket, token.0, interest.events())
    }

    /// Stops watching the socket of a link.
    pub(super) fn remove_link(&self, socket: &SeqPacket) {
        let _ = self.calls.remove(socket);
        let _ = self.node.control.remove(socket);
    }
}
