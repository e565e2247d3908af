//! The connection of one node and the frames that its socket has not accepted yet.

use std::collections::VecDeque;
use std::io::IoSlice;
use std::os::fd::{AsFd, OwnedFd};
use std::rc::Rc;

use sm2_io::{SendError, SeqPacket};

/// How many bytes are queued for a node that does not read (SM2-TRN-008).
const QUEUE_BYTES: usize = 1 << 20;

/// The smallest size that the kernel accounts for an unread datagram.
const DATAGRAM_BYTES: usize = 512;

/// One connection.
pub(crate) struct Node {
    pub(crate) socket: SeqPacket,
    /// The counters file, which the machine asked to keep.
    pub(crate) counters: Option<Rc<OwnedFd>>,
    waiting: VecDeque<(Vec<u8>, Option<Rc<OwnedFd>>)>,
    waiting_bytes: usize,
    /// Upper bound for descriptors that were sent but not read.
    unread_fds: usize,
}

/// The result of sending to a node.
pub(crate) enum Sent {
    /// All frames are sent, or queued until the socket has room.
    Well,
    /// Frames are queued until fewer descriptors of this process are in flight. The kernel counts them per
    /// sender, over all its sockets.
    Crowded,
    /// The node does not read: the loop gives it up.
    Stalled,
}

impl Node {
    pub(crate) const fn new(socket: SeqPacket) -> Self {
        Self {
            socket,
            counters: None,
            waiting: VecDeque::new(),
            waiting_bytes: 0,
            unread_fds: 0,
        }
    }

    /// Whether frames are queued until the socket has room.
    pub(crate) fn is_waiting(&self) -> bool {
        !self.waiting.is_empty()
    }

    pub(crate) fn send(&mut self, frame: Vec<u8>, fd: Option<Rc<OwnedFd>>) -> Sent {
        self.waiting_bytes += frame.len();
        self.waiting.push_back((frame, fd));
        self.flush()
    }

    /// Sends queued frames until the socket is full.
    pub(crate) fn flush(&mut self) -> Sent {
        while let Some((frame, fd)) = self.waiting.front() {
            let fds: Vec<_> = fd.iter().map(|fd| fd.as_fd()).collect();
            match self.socket.send(&[IoSlice::new(frame)], &fds) {
                Ok(()) => {
                    self.unread_fds += fds.len();
                    self.waiting_bytes -= frame.len();
                    self.waiting.pop_front();
                }
                // The loop notices room in the socket and the end of the connection.
                Err(SendError::WouldBlock | SendError::Closed) => break,
                Err(SendError::TooManyInFlight) if self.waiting_bytes <= QUEUE_BYTES => {
                    return Sent::Crowded;
                }
                Err(_) => return Sent::Stalled,
            }
        }
        if self.waiting_bytes > QUEUE_BYTES {
            return Sent::Stalled;
        }
        Sent::Well
    }

    /// Upper bound for the descriptors that are queued or unread.
    pub(crate) fn untaken_fds(&mut self) -> usize {
        let unread_bytes = self.socket.unread_bytes().unwrap_or(0);
        self.unread_fds = self.unread_fds.min(unread_bytes / DATAGRAM_BYTES);
        let waiting = self.waiting.iter().filter(|(_, fd)| fd.is_some());
        self.unread_fds + waiting.count()
    }

    /// Sends the goodbye if no other frame is queued, then closes the connection.
    pub(crate) fn close(self, goodbye: Option<Vec<u8>>) {
        if let Some(goodbye) = goodbye
            && !self.is_waiting()
        {
            // A node whose socket is full finds the connection closed.
            let _ = self.socket.send(&[IoSlice::new(&goodbye)], &[]);
        }
    }
}
