//! One node's connection, and what its socket has not taken yet.

use std::collections::VecDeque;
use std::io::IoSlice;
use std::os::fd::{AsFd, OwnedFd};
use std::rc::Rc;

use sm2_io::{SendError, SeqPacket};

/// How many bytes are kept for a node that does not read (SM2-TRN-009).
const QUEUE_BYTES: usize = 1 << 20;

/// What the kernel counts for a datagram that is not read, at least.
const DATAGRAM_BYTES: usize = 512;

/// One connection.
pub(crate) struct Node {
    pub(crate) socket: SeqPacket,
    /// The file that the machine wants to be kept.
    pub(crate) counters: Option<Rc<OwnedFd>>,
    waiting: VecDeque<(Vec<u8>, Option<Rc<OwnedFd>>)>,
    waiting_bytes: usize,
    /// Descriptors that were sent, less those that were seen to be read.
    unread_fds: usize,
}

/// What became of the frames for a node.
pub(crate) enum Sent {
    /// They are sent, or wait for room.
    Well,
    /// They wait until fewer of our descriptors are in flight, to whomever: the kernel
    /// counts them for their sender.
    Crowded,
    /// It does not read: it is to be given up.
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

    /// Whether room in its socket is of use.
    pub(crate) fn is_waiting(&self) -> bool {
        !self.waiting.is_empty()
    }

    pub(crate) fn send(&mut self, frame: Vec<u8>, fd: Option<Rc<OwnedFd>>) -> Sent {
        self.waiting_bytes += frame.len();
        self.waiting.push_back((frame, fd));
        self.flush()
    }

    /// Sends what waits, as far as the socket takes it.
    pub(crate) fn flush(&mut self) -> Sent {
        while let Some((frame, fd)) = self.waiting.front() {
            let fds: Vec<_> = fd.iter().map(|fd| fd.as_fd()).collect();
            match self.socket.send(&[IoSlice::new(frame)], &fds) {
                Ok(()) => {
                    self.unread_fds += fds.len();
                    self.waiting_bytes -= frame.len();
                    self.waiting.pop_front();
                }
                // The loop hears of room, and of the end of the connection.
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

    /// How many descriptors it has not taken, at most.
    pub(crate) fn untaken_fds(&mut self) -> usize {
        let unread_bytes = self.socket.unread_bytes().unwrap_or(0);
        self.unread_fds = self.unread_fds.min(unread_bytes / DATAGRAM_BYTES);
        let waiting = self.waiting.iter().filter(|(_, fd)| fd.is_some());
        self.unread_fds + waiting.count()
    }

    /// Says the last word, if it has taken all others, and closes the connection.
    pub(crate) fn close(self, goodbye: Option<Vec<u8>>) {
        if let Some(goodbye) = goodbye
            && !self.is_waiting()
        {
            // Whoever does not take it finds the connection closed.
            let _ = self.socket.send(&[IoSlice::new(&goodbye)], &[]);
        }
    }
}
