//! Raw peers: they speak bytes, and nothing keeps them to SPEC.

use std::{
    io::IoSlice,
    os::fd::{AsFd, BorrowedFd, OwnedFd},
    path::Path,
};

use sm2_io::{Listener, RecvError, SendError, SeqPacket, wait_readable};
use sm2_proto::{
    Code, Datagram, FdFacts, LinkId, Violation, ViolationKind,
    control::{Item, Peer, ToNode, decode_to_node},
    limits::DATAGRAM_MAX,
};

use crate::{TIMEOUT, control, eventually, link};

/// One end of a connection, and what came over it.
#[derive(Debug)]
pub struct RawPeer {
    socket: SeqPacket,
}

/// One datagram that a raw peer received.
#[derive(Debug)]
pub struct Frame {
    /// Its bytes.
    pub bytes: Vec<u8>,
    /// The descriptors of the datagram.
    pub fds: Vec<OwnedFd>,
}

impl RawPeer {
    /// The end of a connection that this peer speaks on.
    #[must_use]
    pub const fn new(socket: SeqPacket) -> Self {
        Self { socket }
    }

    /// Connects to a Manager.
    #[must_use]
    #[track_caller]
    pub fn connect(path: &Path) -> Self {
        let mut socket = None;
        // WouldBlock: the backlog is full for a moment.
        eventually("a connection with the Manager", || {
            match SeqPacket::connect(path) {
                Ok(new) => socket = Some(new),
                Err(error) if error.kind() == std::io::ErrorKind::WouldBlock => {}
                Err(error) => panic!("cannot connect to {path:?}: {error}"),
            }
            socket.is_some()
        });
        Self::new(socket.expect("a connection"))
    }

    /// Whether the other side has read all that was sent.
    #[must_use]
    #[track_caller]
    pub fn is_read(&self) -> bool {
        self.socket.unread_bytes().expect("a connected socket") == 0
    }

    /// Sends one datagram.
    #[track_caller]
    pub fn send(&self, bytes: impl AsRef<[u8]>) {
        self.send_fds(bytes, &[]);
    }

    /// Sends one datagram with descriptors; waits until the socket takes it.
    #[track_caller]
    pub fn send_fds(&self, bytes: impl AsRef<[u8]>, fds: &[BorrowedFd<'_>]) {
        eventually("room to send", || {
            match self.try_send(bytes.as_ref(), fds) {
                Ok(()) => true,
                Err(SendError::WouldBlock | SendError::TooManyInFlight) => false,
                Err(error) => panic!("cannot send: {error}"),
            }
        });
    }

    /// Sends one datagram if the socket takes it now.
    ///
    /// # Errors
    ///
    /// As [`SeqPacket::send`].
    pub fn try_send(&self, bytes: &[u8], fds: &[BorrowedFd<'_>]) -> Result<(), SendError> {
        self.socket.send(&[IoSlice::new(bytes)], fds)
    }

    /// Waits until there is something to read.
    #[track_caller]
    pub fn readable(&self) {
        let there = wait_readable(&[self.socket.as_fd()], Some(TIMEOUT)).expect("poll");
        assert!(there, "the other side says nothing");
    }

    /// The next datagram; none at the end of the stream.
    #[must_use]
    #[track_caller]
    pub fn recv(&self) -> Option<Frame> {
        self.readable();
        self.try_recv().expect("something is there")
    }

    /// The next datagram (none at the end of the stream), if there is one already.
    pub fn try_recv(&self) -> Option<Option<Frame>> {
        let mut buffer = vec![0; DATAGRAM_MAX + 1];
        match self.socket.recv(&mut buffer) {
            Ok(received) => {
                assert!(!received.data_truncated && !received.control_truncated);
                buffer.truncate(received.len);
                let fds = received.fds.into_vec();
                Some(Some(Frame { bytes: buffer, fds }))
            }
            Err(RecvError::WouldBlock) => None,
            Err(RecvError::Closed) => Some(None),
            Err(RecvError::Io(error)) => panic!("cannot receive: {error}"),
        }
    }

    /// The next datagram, which must come.
    #[track_caller]
    pub fn expect(&self) -> Frame {
        self.recv().expect("the stream has ended")
    }

    /// Whether nothing is there to be read, not even the end.
    #[must_use]
    pub fn is_quiet(&self) -> bool {
        self.try_recv().is_none()
    }

    /// Closes the connection.
    pub fn close(self) {}

    /// The socket, for what this type does not offer.
    #[must_use]
    pub const fn socket(&self) -> &SeqPacket {
        &self.socket
    }
}

/// Closing alone could take a while: a child that another thread is just starting holds a
/// copy of every descriptor until it runs its program.
impl Drop for RawPeer {
    fn drop(&mut self) {
        let _ = self.socket.shutdown();
    }
}

/// A node that is no node: it sends what a test wants to its Manager.
#[derive(Debug)]
pub struct RawNode {
    peer: RawPeer,
}

/// A link that LINK has brought to a raw node.
#[derive(Debug)]
pub struct RawLink {
    /// The node's interface.
    pub interface: u64,
    /// The link.
    pub id: LinkId,
    /// The secret of its two ends.
    pub key: u64,
    /// Whether nothing on it may be displaced.
    pub reliable: bool,
    /// Whether pooled payloads are forbidden.
    pub sealed: bool,
    /// The other side.
    pub peer: Peer,
    /// This node's end.
    pub end: RawPeer,
}

impl RawNode {
    /// A connection that has not greeted.
    #[must_use]
    #[track_caller]
    pub fn connect(path: &Path) -> Self {
        Self {
            peer: RawPeer::connect(path),
        }
    }

    /// A ready node.
    #[must_use]
    #[track_caller]
    pub fn welcomed(path: &Path, name: &str) -> Self {
        let node = Self::connect(path);
        node.greet(name);
        node
    }

    /// Greets, and is welcome. Its number and the epoch.
    #[track_caller]
    pub fn greet(&self, name: &str) -> (u64, u64) {
        self.send(control::hello(name));
        match self.next() {
            ToNode::Welcome { node, epoch, .. } => (node.0, epoch),
            other => panic!("WELCOME expected: {other:?}"),
        }
    }

    /// Greets as a node that comes back, and is welcome. Its number and the epoch.
    #[track_caller]
    pub fn greet_again(&self, name: &str) -> (u64, u64) {
        self.send(control::hello_again(name));
        match self.next() {
            ToNode::Welcome { node, epoch, .. } => (node.0, epoch),
            other => panic!("WELCOME expected: {other:?}"),
        }
    }

    /// The next frame, which is PAGE; its revision.
    #[track_caller]
    pub fn revision(&self) -> u64 {
        match self.next() {
            ToNode::Page { revision, .. } => revision,
            other => panic!("PAGE expected: {other:?}"),
        }
    }

    /// Sends one datagram.
    #[track_caller]
    pub fn send(&self, bytes: impl AsRef<[u8]>) {
        self.peer.send(bytes);
    }

    /// Sends one datagram with descriptors.
    #[track_caller]
    pub fn send_fds(&self, bytes: impl AsRef<[u8]>, fds: &[BorrowedFd<'_>]) {
        self.peer.send_fds(bytes, fds);
    }

    /// The connection.
    #[must_use]
    pub const fn peer(&self) -> &RawPeer {
        &self.peer
    }

    /// The next frame, which carries no descriptor.
    #[track_caller]
    pub fn next(&self) -> ToNode {
        self.next_with_fds().0
    }

    /// The next frame and its descriptors.
    #[track_caller]
    pub fn next_with_fds(&self) -> (ToNode, Vec<OwnedFd>) {
        let frame = self.peer.expect();
        (decode(&frame).expect("a legal frame"), frame.fds)
    }

    /// Declares an interface, which is granted; how many links follow.
    #[track_caller]
    pub fn declare(&self, interface: u64, contract: &[u8]) -> u32 {
        self.send(control::declare(interface, contract));
        match self.next() {
            ToNode::Declared {
                interface: answered,
                matches,
            } if answered.0 == interface => matches,
            other => panic!("DECLARED {interface} expected: {other:?}"),
        }
    }

    /// The next frame, which is LINK.
    #[track_caller]
    pub fn linked(&self) -> RawLink {
        let (frame, fds) = self.next_with_fds();
        let ToNode::Link {
            interface,
            link,
            key,
            reliable,
            sealed,
            peer,
            ..
        } = frame
        else {
            panic!("LINK expected: {frame:?}");
        };
        let fd = fds.into_iter().next().expect("a socket");
        RawLink {
            interface: interface.0,
            id: link,
            key: key.0,
            reliable,
            sealed,
            peer,
            end: RawPeer::new(SeqPacket::from_fd(fd).expect("a socket")),
        }
    }

    /// The next frame, which is UNLINK of this link; its code.
    #[track_caller]
    pub fn unlinked(&self, id: LinkId) -> Code {
        match self.next() {
            ToNode::Unlink { link, code, .. } if link == id => code,
            other => panic!("UNLINK of {id} expected: {other:?}"),
        }
    }

    /// Asks for the first page: its items.
    #[track_caller]
    pub fn query(&self) -> Vec<Item> {
        self.send(control::query());
        match self.next() {
            ToNode::Page { items, .. } => items,
            other => panic!("PAGE expected: {other:?}"),
        }
    }

    /// Asks for all pages, one after the other: their items.
    #[track_caller]
    pub fn query_all(&self) -> Vec<Item> {
        let mut all = Vec::new();
        let mut query = control::query();
        loop {
            self.send(query);
            let ToNode::Page { items, next, .. } = self.next() else {
                panic!("PAGE expected");
            };
            all.extend(items);
            let Some(next) = next else {
                return all;
            };
            query = control::query_after(next);
        }
    }

    /// The names of the nodes on the first page.
    #[track_caller]
    pub fn nodes(&self) -> Vec<String> {
        let items = self.query().into_iter();
        let names = items.filter_map(|item| match item {
            Item::Node { name, .. } => Some(name.as_str().to_owned()),
            _ => None,
        });
        names.collect()
    }

    /// Reads to the end of the stream, which may only be preceded by GOODBYE.
    #[track_caller]
    pub fn ended(&self) -> Option<Code> {
        let frame = self.peer.recv()?;
        let Ok(ToNode::Goodbye { code }) = decode(&frame) else {
            panic!("GOODBYE expected: {frame:?}");
        };
        let after = self.peer.recv();
        assert!(after.is_none(), "sent after GOODBYE: {after:?}");
        Some(code)
    }

    /// Hangs up without a word.
    pub fn close(self) {}
}

/// Reads a frame from a Manager, strictly.
fn decode(frame: &Frame) -> Result<ToNode, Violation> {
    let facts = vec![FdFacts::default(); frame.fds.len()];
    decode_to_node(&Datagram {
        fds: &facts,
        ..Datagram::new(&frame.bytes)
    })
}

impl RawLink {
    /// Says OPEN in this role, and reads the other side's.
    #[track_caller]
    pub fn open(&self, role: u8, window: u32) -> Frame {
        self.end
            .send(link::Open::new(role, self.id, window).bytes());
        let frame = self.end.expect();
        assert_eq!(frame.bytes[0], link::kind::OPEN, "OPEN comes first");
        frame
    }

    /// The name of the violation that ended it, by what is there to read; none if it goes on.
    #[track_caller]
    pub fn verdict(&self) -> Option<&'static str> {
        while let Some(frame) = self.end.try_recv() {
            let bytes = frame.expect("CLOSE before the end").bytes;
            if bytes[0] == link::kind::CLOSE {
                let code = u16::from_le_bytes([bytes[2], bytes[3]]);
                let violation = ViolationKind::from_code(Code(code));
                return Some(violation.expect("a violation").name());
            }
        }
        None
    }

    /// Reads until CLOSE, which ends the stream; its code. None if there was no CLOSE.
    #[track_caller]
    pub fn closed(&self) -> Option<u16> {
        while let Some(frame) = self.end.recv() {
            if frame.bytes[0] == link::kind::CLOSE {
                let after = self.end.recv();
                assert!(after.is_none(), "sent after CLOSE: {after:?}");
                assert_eq!(frame.bytes.len(), 8, "CLOSE: {frame:?}");
                return Some(u16::from_le_bytes([frame.bytes[2], frame.bytes[3]]));
            }
        }
        None
    }
}

/// A Manager that is no Manager: it says to a node what a test wants.
#[derive(Debug)]
pub struct RawManager {
    listener: Listener,
}

impl RawManager {
    /// Listens at `path`.
    #[must_use]
    pub fn listen(path: &Path) -> Self {
        let listener = Listener::bind(path, 16).expect("a socket to listen at");
        Self { listener }
    }

    /// The next node that connects.
    #[must_use]
    #[track_caller]
    pub fn accept(&self) -> RawPeer {
        let there = wait_readable(&[self.listener.as_fd()], Some(TIMEOUT)).expect("poll");
        assert!(there, "no node connects");
        let socket = self.listener.accept().expect("accept");
        RawPeer::new(socket.expect("a connection"))
    }
}
