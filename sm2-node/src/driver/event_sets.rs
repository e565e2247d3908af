//! The epoll sets of a node: the descriptors that wake calls of the program, and those that wake the background
//! thread.

use std::io;
use std::os::fd::{AsFd, BorrowedFd};

use sm2_io::{Epoll, Interest, SeqPacket};

use super::token::{CONTROL, LinkToken};

/// The epoll sets of a node.
///
/// | descriptor | set `calls` | set `control`, with a background thread | without one |
/// | --- | --- | --- | --- |
/// | session, reconnect timer | through `control`, until the thread runs | readable, writable | the same |
/// | link | readable, writable | [`BackgroundInterest`] | not in the set |
#[derive(Debug)]
pub(crate) struct EventSets {
    /// The descriptors that calls of the program read and write.
    pub(super) calls: Epoll,
    /// The descriptors of the control side.
    pub(super) control: Epoll,
    has_background: bool,
}

/// The events of a link for which the background thread wakes.
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

impl EventSets {
    /// Creates the sets of a node whose calls drive it, until [`detach_control`](Self::detach_control).
    pub(super) fn new(has_background: bool) -> io::Result<Self> {
        let (calls, control) = (Epoll::new()?, Epoll::new()?);
        calls.add(&control, CONTROL, Interest::READABLE)?;
        Ok(Self {
            calls,
            control,
            has_background,
        })
    }

    /// Stops waking calls for the control side, because the background thread drives it.
    pub(super) fn detach_control(&self) -> io::Result<()> {
        self.calls.remove(&self.control)
    }

    /// Whether the background thread watches links.
    pub(super) const fn has_background(&self) -> bool {
        self.has_background
    }

    /// Watches the socket of a new link.
    pub(super) fn add_link(&self, socket: &SeqPacket, token: LinkToken) -> io::Result<()> {
        self.calls.add(socket, token.0, Interest::READABLE)?;
        if self.has_background {
            let interest = BackgroundInterest::Packets.events();
            self.control
                .add(socket, token.0, interest)
                .inspect_err(|_| self.remove_link(socket))?;
        }
        Ok(())
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

    /// Changes the events of a link that wake the background thread.
    pub(super) fn watch_link_in_background(
        &self,
        socket: &SeqPacket,
        token: LinkToken,
        interest: BackgroundInterest,
    ) -> io::Result<()> {
        self.control.modify(socket, token.0, interest.events())
    }

    /// Stops watching the socket of a link.
    pub(super) fn remove_link(&self, socket: &SeqPacket) {
        let _ = self.calls.remove(socket);
        if self.has_background {
            let _ = self.control.remove(socket);
        }
    }
}

/// The descriptor that wakes calls of the program.
impl AsFd for EventSets {
    fn as_fd(&self) -> BorrowedFd<'_> {
        self.calls.as_fd()
    }
}
