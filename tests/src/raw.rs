//! Raw peers, which send arbitrary bytes and are not bound to SPEC.

use std::{
    io::IoSlice,
    os::fd::{AsFd, BorrowedFd, OwnedFd},
    path::Path,
};

use sm2_io::{Listener, RecvError, SendError, SeqPacket, wait_readable};
use sm2_proto::{
    Code, Datagram, FdFacts, LinkId, Violation, ViolationKind,
    control::{Item, LinkPeer, Page, ToNode, decode_to_node},
    limits::DATAGRAM_MAX,
};

use crate::{TIMEOUT, control, eventually, link};

/// One end of a connection, and the datagrams that it received.
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
    /// A peer on this end of a connection.
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

    /// True if the other side has read everything that was sent.
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

    /// Waits until there is a datagram to read.
    #[track_caller]
    pub fn readable(&self) {
        let there = wait_readable(&[self.socket.as_fd()], Some(TIMEOUT)).expect("poll");
        assert!(there, "the other side says nothing");
    }

    /// The next datagram, or `None` at the end of the stream.
    #[must_use]
    #[track_caller]
    pub fn next_frame(&self) -> Option<Frame> {
        self.readable();
        self.try_recv().expect("something is there")
    }

    /// The next datagram (or `None` at the end of the stream), if it has arrived already.
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

    /// The next datagram, which must arrive.
    #[track_caller]
    pub fn expect(&self) -> Frame {
        self.next_frame().expect("the stream has ended")
    }

    /// True if there is nothing to read, not even the end of the stream.
    #[must_use]
    pub fn is_quiet(&self) -> bool {
        self.try_recv().is_none()
    }

    /// Closes the connection.
    pub fn close(self) {}

    /// The socket, for operations that this type lacks.
    #[must_use]
    pub const fn socket(&self) -> &SeqPacket {
        &self.socket
    }
}

/// Shuts the connection down explicitly. A child that another thread is just starting holds a copy
/// of every descriptor until it runs its program, so closing alone might take effect late.
impl Drop for RawPeer {
    fn drop(&mut self) {
        let _ = self.socket.shutdown();
    }
}

/// A raw node, which sends its Manager the bytes that a test chooses.
#[derive(Debug)]
pub struct RawNode {
    peer: RawPeer,
}

/// A link that a LINK frame has given to a raw node.
#[derive(Debug)]
pub struct RawLink {
    /// The node's interface.
    pub interface: u64,
    /// The link.
    pub id: LinkId,
    /// The secret of its two ends.
    pub key: u64,
    /// True if no message on the link may be displaced.
    pub reliable: bool,
    /// True if pooled payloads are forbidden.
    pub sealed: bool,
    /// The other side.
    pub peer: LinkPeer,
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

    /// Greets, and is welcomed. Returns its number and the epoch.
    #[track_caller]
    pub fn greet(&self, name: &str) -> (u64, u64) {
        self.send(control::hello(name));
        match self.next() {
            ToNode::Welcome { node, epoch, .. } => (node.0, epoch),
            other => panic!("WELCOME expected: {other:?}"),
        }
    }

    /// Greets as a node that reconnects, and is welcomed. Returns its number and the epoch.
    #[track_caller]
    pub fn greet_again(&self, name: &str) -> (u64, u64) {
        self.send(control::hello_again(name));
        match self.next() {
            ToNode::Welcome { node, epoch, .. } => (node.0, epoch),
            other => panic!("WELCOME expected: {other:?}"),
        }
    }

    /// Reads the next frame, which must be PAGE. Returns its revision.
    #[track_caller]
    pub fn revision(&self) -> u64 {
        match self.next() {
            ToNode::Page(Page { revision, .. }) => revision,
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

    /// Declares an interface, which must be granted. Returns how many links follow.
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

    /// Reads the next frame, which must be LINK.
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

    /// Reads the next frame, which must be UNLINK of this link. Returns its code.
    #[track_caller]
    pub fn unlinked(&self, id: LinkId) -> Code {
        match self.next() {
            ToNode::Unlink { link, code, .. } if link == id => code,
            other => panic!("UNLINK of {id} expected: {other:?}"),
        }
    }

    /// Queries the first page. Returns its items.
    #[track_caller]
    pub fn query(&self) -> Vec<Item> {
        self.send(control::query());
        match self.next() {
            ToNode::Page(Page { items, .. }) => items,
            other => panic!("PAGE expected: {other:?}"),
        }
    }

    /// Queries all pages, one after the other. Returns their items.
    #[track_caller]
    pub fn query_all(&self) -> Vec<Item> {
        let mut all = Vec::new();
        let mut query = control::query();
        loop {
            self.send(query);
            let ToNode::Page(Page { items, next, .. }) = self.next() else {
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

    /// Reads to the end of the stream. Only answers to RELOAD and GOODBYE may precede it.
    #[track_caller]
    pub fn ended(&self) -> Option<Code> {
        let mut frame = self.peer.next_frame()?;
        while let Ok(ToNode::Reloaded { .. }) = decode(&frame) {
            frame = self.peer.next_frame()?;
        }
        let Ok(ToNode::Goodbye { code }) = decode(&frame) else {
            panic!("GOODBYE expected: {frame:?}");
        };
        let after = self.peer.next_frame();
        assert!(after.is_none(), "sent after GOODBYE: {after:?}");
        Some(code)
    }

    /// Closes the connection without GOODBYE.
    pub fn close(self) {}
}

/// Decodes a frame of a Manager with all checks.
fn decode(frame: &Frame) -> Result<ToNode, Violation> {
    let facts = vec![FdFacts::default(); frame.fds.len()];
    decode_to_node(&Datagram {
        fds: &facts,
        ..Datagram::new(&frame.bytes)
    })
}

impl RawLink {
    /// Sends OPEN in this role, and reads the other side's.
    #[track_caller]
    pub fn open(&self, role: u8, window: u32) -> Frame {
        self.end
            .send(link::Open::new(role, self.id, window).bytes());
        let frame = self.end.expect();
        assert_eq!(frame.bytes[0], link::kind::OPEN, "OPEN comes first");
        frame
    }

    /// Reads the available datagrams. Returns the name of the violation that ended the link, or
    /// `None` if the link is open.
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

    /// Reads until CLOSE, which ends the stream. Returns its code, or `None` if there was no CLOSE.
    #[track_caller]
    pub fn closed(&self) -> Option<u16> {
        while let Some(frame) = self.end.next_frame() {
            if frame.bytes[0] == link::kind::CLOSE {
                let after = self.end.next_frame();
                assert!(after.is_none(), "sent after CLOSE: {after:?}");
                assert_eq!(frame.bytes.len(), 8, "CLOSE: {frame:?}");
                return Some(u16::from_le_bytes([frame.bytes[2], frame.bytes[3]]));
            }
        }
        None
    }
}

/// A raw Manager, which sends nodes the bytes that a test chooses.
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

    /// Accepts the next node that connects.
    #[must_use]
    #[track_caller]
    pub fn accept(&self) -> RawPeer {
        let there = wait_readable(&[self.listener.as_fd()], Some(TIMEOUT)).expect("poll");
        assert!(there, "no node connects");
        let socket = self.listener.accept().expect("accept");
        RawPeer::new(socket.expect("a connection"))
    }
}
