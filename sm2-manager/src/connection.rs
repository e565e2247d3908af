//! The connection of one node: its socket and the frames that the socket has not accepted yet.

use std::{
    collections::VecDeque,
    io::IoSlice,
    os::fd::{AsFd, OwnedFd},
    sync::Arc,
};

use sm2_io::{Epoll, Interest, ProcessFd, SendError, SeqPacket, is_shortage};

/// One datagram to send: a frame and the descriptor that accompanies it.
#[derive(Debug)]
struct Parcel {
    frame: Vec<u8>,
    /// Shared if it is a counters file: the kernel duplicates the descriptor when it is sent.
    fd: Option<Arc<OwnedFd>>,
}

impl Parcel {
    /// Memory that this parcel occupies while it is queued. The parcel can be larger than its frame.
    fn kept_bytes(&self) -> usize {
        size_of::<Self>() + self.frame.len()
    }
}

#[derive(Debug)]
pub(crate) struct Connection {
    pub(crate) socket: SeqPacket,
    /// The events that the epoll set watches the socket for.
    pub(crate) interest: Interest,
    waiting: VecDeque<Parcel>,
    waiting_bytes: usize,
    /// Descriptors sent since the socket's queue was last seen empty.
    sent_fds: usize,
    /// The connection is about to be closed: nothing is queued for it any more.
    given_up: bool,
    /// The node's counters file, once the node has handed it over.
    pub(crate) counters: Option<Arc<OwnedFd>>,
    /// A placeholder descriptor, closed before each read, so that the counters file can be received. Without
    /// a free descriptor the kernel would discard the file, and tools would not see the node's counters.
    pub(crate) place: Option<OwnedFd>,
    /// The process that has connected, until it has ended. `None` if the kernel cannot tell.
    pub(crate) process: Option<ProcessFd>,
}

/// The result of sending a frame to a node that is still connected.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Sent {
    /// The socket accepted the frame.
    Taken,
    /// The frame is queued until the socket has room.
    Full,
    /// The frame is queued until fewer descriptors of this process are in flight. The kernel counts them per
    /// sender, over all its sockets (`ETOOMANYREFS`).
    Crowded,
    /// The frame is queued until the kernel has memory for it.
    Short,
}

/// The smallest size that the kernel accounts for an unread datagram.
const DATAGRAM_BYTES: usize = 512;

/// The reason why a node is given up.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Lost {
    /// The node closed its end; reading the socket reports the end.
    Closed,
    /// The node does not read its socket.
    Stalled,
}

impl Connection {
    pub(crate) const fn new(socket: SeqPacket, place: OwnedFd, process: Option<ProcessFd>) -> Self {
        Self {
            socket,
            interest: Interest::READABLE,
            waiting: VecDeque::new(),
            waiting_bytes: 0,
            sent_fds: 0,
            given_up: false,
            counters: None,
            place: Some(place),
            process,
        }
    }

    /// Number of queued descriptors that no other queue shares.
    pub(crate) fn waiting_fds(&self) -> usize {
        let fds = self.waiting.iter().filter_map(|parcel| parcel.fd.as_ref());
        fds.filter(|fd| Arc::strong_count(fd) == 1).count()
    }

    /// Discards everything that is queued, and queues nothing from now on.
    pub(crate) fn give_up(&mut self) {
        self.given_up = true;
        self.waiting = VecDeque::new();
        self.waiting_bytes = 0;
    }

    /// Whether frames are queued until the socket has room.
    pub(crate) fn is_waiting(&self) -> bool {
        !self.waiting.is_empty()
    }

    /// Sends a frame now, or queues it. The queue is limited to `limit_bytes`.
    //= SM2-TRN-008
    pub(crate) fn send(
        &mut self,
        frame: Vec<u8>,
        fd: Option<Arc<OwnedFd>>,
        limit_bytes: usize,
    ) -> Result<Sent, Lost> {
        if self.given_up {
            return Ok(Sent::Taken);
        }
        let parcel = Parcel { frame, fd };
        let sent = match self.is_waiting() {
            true => Sent::Full,
            false => self.transmit(&parcel)?,
        };
        if sent == Sent::Taken {
            return Ok(sent);
        }
        self.waiting_bytes += parcel.kept_bytes();
        if self.waiting_bytes > limit_bytes {
            return Err(Lost::Stalled);
        }
        self.waiting.push_back(parcel);
        Ok(sent)
    }

    /// Sends queued frames until the socket is full.
    pub(crate) fn flush(&mut self) -> Result<Sent, Lost> {
        while let Some(parcel) = self.waiting.pop_front() {
            let sent = self.transmit(&parcel)?;
            if sent != Sent::Taken {
                self.waiting.push_front(parcel);
                return Ok(sent);
            }
            self.waiting_bytes -= parcel.kept_bytes();
        }
        Ok(Sent::Taken)
    }

    /// Upper bound for the descriptors that the node has not read: at most those sent since its queue was
    /// last empty, and at most one per unread datagram.
    pub(crate) fn unread_fds(&mut self) -> usize {
        let unread_bytes = self.socket.unread_bytes().unwrap_or(0);
        if unread_bytes == 0 {
            self.sent_fds = 0;
        }
        self.sent_fds.min(unread_bytes / DATAGRAM_BYTES)
    }

    fn transmit(&mut self, parcel: &Parcel) -> Result<Sent, Lost> {
        if self.sent_fds != 0 {
            // Resets `sent_fds` if the node has read everything.
            self.unread_fds();
        }
        let sent = transmit(&self.socket, parcel)?;
        if parcel.fd.is_some() && sent == Sent::Taken {
            self.sent_fds += 1;
        }
        Ok(sent)
    }

    /// Stops watching the process that has connected. Closing its descriptor would not do, if another process has it.
    pub(crate) fn forget_process(&mut self, epoll: &Epoll) {
        if let Some(process) = self.process.take() {
            let _ = epoll.remove(&process);
        }
    }

    /// Sends the last frame if the socket accepts it.
    //= SM2-SES-005
    pub(crate) fn say_goodbye(mut self, frame: Option<Vec<u8>>) {
        let Some(frame) = frame else { return };
        if self.flush() == Ok(Sent::Taken) {
            // A node whose socket is full finds the connection closed.
            let _ = self.transmit(&Parcel { frame, fd: None });
        }
    }
}

fn transmit(socket: &SeqPacket, parcel: &Parcel) -> Result<Sent, Lost> {
    let parts = [IoSlice::new(&parcel.frame)];
    let result = match &parcel.fd {
        Some(fd) => socket.send(&parts, &[fd.as_fd()]),
        None => socket.send(&parts, &[]),
    };
    match result {
        Ok(()) => Ok(Sent::Taken),
        Err(SendError::WouldBlock) => Ok(Sent::Full),
        //= SM2-TRN-009
        Err(SendError::TooManyInFlight) => Ok(Sent::Crowded),
        //= SM2-TRN-012
        Err(SendError::Io(error)) if is_shortage(&error) => Ok(Sent::Short),
        Err(SendError::Closed) => Err(Lost::Closed),
        Err(SendError::TooLong | SendError::Io(_)) => Err(Lost::Stalled),
    }
}

#[cfg(test)]
mod tests;
