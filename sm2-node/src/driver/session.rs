//! The node's session with its Manager: socket and machine.

use std::collections::VecDeque;
use std::io::IoSlice;

use sm2_io::{Epoll, Interest, RecvError, SendError, SeqPacket};
use sm2_proto::control::{Cursor, Item};
use sm2_proto::node::{End, Error, Input, Node, Output};
use sm2_proto::{Code, Contract, Datagram, Farewell, InterfaceId, LinkId, Name, Refusal};

use super::SESSION;
use super::datagram::{Incoming, receive};

#[derive(Debug)]
pub(super) struct Session {
    socket: Option<SeqPacket>,
    machine: Node,
    /// Frames that the socket did not take yet. Bounded by what this node declares.
    unsent: VecDeque<Vec<u8>>,
    /// Whether we wait until the socket is writable.
    blocked: bool,
    pub(super) greeting: Greeting,
    /// The answer to the last query.
    page: Option<Page>,
    /// Queries without an answer. Pages come in the order of the queries.
    pages_due: u64,
}

/// How far the greeting has come.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) enum Greeting {
    Sent,
    Refused(Refusal),
    Welcomed,
}

/// A part of the domain's state.
#[derive(Clone, Debug)]
pub(crate) struct Page {
    pub(crate) revision: u64,
    pub(crate) items: Vec<Item>,
    pub(crate) next: Option<Cursor>,
}

impl Session {
    /// Greets the Manager at the other end of `socket`.
    pub(super) fn new(socket: SeqPacket, name: Name) -> Self {
        Self {
            socket: Some(socket),
            machine: Node::new(name),
            unsent: VecDeque::new(),
            blocked: false,
            greeting: Greeting::Sent,
            page: None,
            pages_due: 0,
        }
    }

    pub(super) fn end(&self) -> Option<End> {
        self.machine.end()
    }

    pub(super) fn declare(&mut self, contract: Contract) -> Result<InterfaceId, Error> {
        self.machine.declare(contract)
    }

    /// Tells the Manager something. What it does not apply to is over anyway: the session,
    /// or what the input names.
    pub(super) fn tell(&mut self, input: Input<'_>) {
        let _ = self.machine.handle(sm2_io::clock::now(), input);
    }

    pub(super) fn unlinked(&mut self, interface: InterfaceId, link: LinkId, code: Code) {
        self.tell(Input::Unlinked {
            interface,
            link,
            code,
        });
    }

    /// Asks for a page of the domain's state.
    pub(super) fn query(&mut self, after: Option<Cursor>) {
        self.page = None;
        self.pages_due += 1;
        self.tell(Input::Query { after });
    }

    /// A page came. It counts only if it answers the last query.
    pub(super) fn answer(&mut self, page: Page) {
        self.pages_due -= 1;
        self.page = (self.pages_due == 0).then_some(page);
    }

    pub(super) const fn take_page(&mut self) -> Option<Page> {
        self.page.take()
    }

    /// Reads one datagram. `None` if none is there.
    pub(super) fn receive(&mut self, buffer: &mut [u8]) -> Option<Incoming> {
        let incoming = match receive(self.socket.as_ref()?, buffer) {
            Ok(incoming) => incoming,
            Err(RecvError::WouldBlock) => return None,
            Err(RecvError::Closed) => {
                self.tell(Input::Eof);
                return Some(Incoming::default());
            }
            Err(RecvError::Io(error)) => {
                tracing::warn!(%error, "the connection with the Manager failed");
                self.tell(Input::Eof);
                return Some(Incoming::default());
            }
        };
        let datagram = Datagram {
            bytes: &buffer[..incoming.len],
            fds: &incoming.facts,
            data_truncated: incoming.data_truncated,
            control_truncated: incoming.control_truncated,
        };
        self.tell(Input::Datagram(datagram));
        Some(incoming)
    }

    /// What the machine wants done next.
    pub(super) fn poll(&mut self) -> Option<Output> {
        self.machine.poll()
    }

    /// Sends a frame, after those that wait.
    pub(super) fn send(&mut self, frame: Vec<u8>, epoll: &Epoll) {
        self.unsent.push_back(frame);
        self.flush(epoll);
    }

    /// Sends what the socket takes.
    pub(super) fn flush(&mut self, epoll: &Epoll) {
        let Some(socket) = &self.socket else {
            self.unsent.clear();
            return;
        };
        while let Some(frame) = self.unsent.front() {
            match socket.send(&[IoSlice::new(frame)], &[]) {
                // Whoever is gone has sent all it will: that is read first, and then the
                // end of the stream (SM2-TRN-006).
                Ok(()) | Err(SendError::Closed) => {}
                Err(SendError::WouldBlock) => break,
                Err(error) => tracing::warn!(%error, "a frame for the Manager was lost"),
            }
            self.unsent.pop_front();
        }
        let blocked = !self.unsent.is_empty();
        if blocked != self.blocked {
            self.blocked = blocked;
            let interest = if blocked {
                Interest::BOTH
            } else {
                Interest::READABLE
            };
            let _ = epoll.modify(socket, SESSION, interest);
        }
    }

    /// The session is over: says why, and closes the connection.
    pub(super) fn hang_up(&mut self, end: End, epoll: &Epoll) {
        match end {
            End::Violation(rule) => tracing::warn!(
                rule = rule.name(),
                clause = rule.clause(),
                "the Manager broke the protocol; the session is over, links go on"
            ),
            End::Peer(code) if code != Farewell::Done.code() => {
                tracing::warn!(%code, "the Manager hung up; links go on");
            }
            End::Peer(_) | End::Eof => tracing::info!("the Manager is gone; links go on"),
            End::Local(_) => {}
        }
        self.unsent.clear();
        if let Some(socket) = self.socket.take() {
            let _ = epoll.remove(&socket);
            let _ = socket.shutdown();
        }
    }
}
