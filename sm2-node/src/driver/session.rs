//! The node's session with its Manager: the socket and the machine.

mod links;
mod outputs;
mod reconnect;
mod requests;
mod retry;

use std::collections::VecDeque;
use std::io::IoSlice;
use std::os::fd::{AsFd, OwnedFd};

use sm2_io::{Interest, RecvError, SendError, SeqPacket, is_shortage};
use sm2_proto::node::{End, Error, Input, Node, Output};
use sm2_proto::{
    Code, Contract, Datagram, Farewell, InterfaceId, LinkId, Machine, Name, NodeId, Refusal,
};

use super::datagram::{Incoming, receive};
use super::event_sets::NodeSets;
use super::token::SESSION;

pub(crate) use self::requests::NotDeclared;
pub(super) use self::retry::Reconnect;
pub(crate) use self::retry::may_return;

#[derive(Debug)]
pub(super) struct SessionDriver {
    socket: Option<SeqPacket>,
    machine: Node,
    /// Frames that the socket has not accepted. Their number is bounded by the declarations and
    /// requests of this node.
    unsent: VecDeque<Frame>,
    /// Whether the control set also watches for the socket to become writable.
    blocked: bool,
    /// Whether the kernel had no memory for the last frame, or to read the socket (SM2-TRN-013).
    short_of_memory: bool,
    /// The end of the last session. `None` once a Manager knows all interfaces of this node.
    pub(super) away: Option<End>,
    /// The reason why the last greeting was refused, if it was.
    pub(super) refused: Option<Refusal>,
}

/// A datagram to be sent.
#[derive(Debug)]
struct Frame {
    bytes: Vec<u8>,
    fd: Option<OwnedFd>,
}

impl SessionDriver {
    /// Starts a session with the Manager at the other end of `socket`, by a greeting.
    pub(super) fn new(socket: SeqPacket, name: Name) -> Self {
        Self {
            socket: Some(socket),
            machine: Node::new(name),
            unsent: VecDeque::new(),
            blocked: false,
            short_of_memory: false,
            away: None,
            refused: None,
        }
    }

    /// Uses a new connection, which is already in the control set.
    pub(super) fn connected(&mut self, socket: SeqPacket) {
        debug_assert!(self.socket.is_none() && self.unsent.is_empty());
        self.socket = Some(socket);
        self.blocked = false;
        self.short_of_memory = false;
    }

    /// Whether there is a connection with a Manager.
    pub(super) const fn is_connected(&self) -> bool {
        self.socket.is_some()
    }

    /// Whether any Manager has welcomed this node so far.
    pub(super) const fn was_welcomed(&self) -> bool {
        self.machine.was_welcomed()
    }

    /// Whether this node is connected to a Manager that knows all its interfaces and links.
    pub(super) const fn is_ready(&self) -> bool {
        self.machine.is_ready()
    }

    /// Whether the kernel had no memory for the last frame, or to read the socket.
    pub(super) const fn is_short_of_memory(&self) -> bool {
        self.short_of_memory
    }

    /// Prepares for an event of the socket, after which the session may be short of memory again.
    pub(super) const fn begin_event(&mut self) {
        self.short_of_memory = false;
    }

    pub(super) const fn id(&self) -> Option<NodeId> {
        self.machine.id()
    }

    pub(super) const fn epoch(&self) -> Option<u64> {
        self.machine.epoch()
    }

    pub(super) fn declare(&mut self, contract: Contract) -> Result<InterfaceId, Error> {
        self.machine.declare(contract)
    }

    /// Feeds an input. The result is ignored: an error only says that the session, or the object of
    /// the input, has already ended.
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

    /// Reads one datagram; `None` if there is none.
    pub(super) fn receive(&mut self, buffer: &mut [u8]) -> Option<Incoming> {
        let incoming = match receive(self.socket.as_ref()?, buffer) {
            Ok(incoming) => incoming,
            Err(RecvError::WouldBlock) => return None,
            //= SM2-TRN-013
            // The socket stays readable.
            Err(RecvError::Io(error)) if is_shortage(&error) => {
                self.short_of_memory = true;
                return None;
            }
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

    /// Returns the next output of the machine.
    pub(super) fn poll(&mut self) -> Option<Output> {
        self.machine.poll()
    }

    /// Queues a frame after all unsent ones and sends as many as the socket accepts.
    pub(super) fn send(&mut self, bytes: Vec<u8>, fd: Option<OwnedFd>, sets: &NodeSets) {
        self.unsent.push_back(Frame { bytes, fd });
        self.flush(sets);
    }

    /// Sends as many unsent frames as the socket accepts.
    pub(super) fn flush(&mut self, sets: &NodeSets) {
        let Some(socket) = &self.socket else {
            self.unsent.clear();
            return;
        };
        while let Some(Frame { bytes, fd }) = self.unsent.front() {
            let fd = fd.as_ref().map(AsFd::as_fd);
            match socket.send(&[IoSlice::new(bytes)], fd.as_slice()) {
                // The Manager has closed its end. The frames that it sent before are read first,
                // and then the end of the stream (SM2-TRN-005).
                Ok(()) | Err(SendError::Closed) => {}
                Err(SendError::WouldBlock) => break,
                //= SM2-TRN-013
                Err(SendError::TooManyInFlight) => {
                    self.short_of_memory = true;
                    break;
                }
                Err(SendError::Io(error)) if is_shortage(&error) => {
                    self.short_of_memory = true;
                    break;
                }
                Err(error) => tracing::warn!(%error, "a frame for the Manager was lost"),
            }
            self.unsent.pop_front();
        }
        self.watch_again(sets);
    }

    /// Watches for the socket to become writable while frames are unsent. Without memory for this change, the
    /// next drive tries again.
    pub(super) fn watch_again(&mut self, sets: &NodeSets) {
        let blocked = !self.unsent.is_empty();
        let Some(socket) = self.socket.as_ref().filter(|_| blocked != self.blocked) else {
            return;
        };
        let interest = if blocked {
            Interest::BOTH
        } else {
            Interest::READABLE
        };
        if sets.control.modify(socket, SESSION, interest).is_ok() {
            self.blocked = blocked;
        }
    }

    /// Closes the connection.
    pub(super) fn hang_up(&mut self, end: End, sets: &NodeSets) {
        self.away = Some(end);
        self.unsent.clear();
        if let Some(socket) = self.socket.take() {
            let _ = sets.control.remove(&socket);
            let _ = socket.shutdown();
        }
    }

    /// Logs the end of the session, as the last step: if the program's logger panics, the rest is done.
    pub(super) fn log_end(&self, end: End) {
        match end {
            End::Violation(violation) => tracing::warn!(
                violation = %violation.kind(),
                clause = %violation.clause(),
                "the Manager broke the protocol: the session has ended, links stay open"
            ),
            // The refusal was already logged, and each refused attempt ends like this.
            _ if self.refused.is_some() => {}
            End::Peer(code)
                if ![Farewell::Done.code(), Farewell::ShuttingDown.code()].contains(&code) =>
            {
                tracing::warn!(%code, "the Manager closed the session; links stay open");
            }
            End::Peer(_) | End::Eof => tracing::info!("the Manager is gone; links stay open"),
            End::Local(_) => {}
        }
    }
}
