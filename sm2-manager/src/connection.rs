//! One node's connection: its socket and what the socket did not take yet.

use std::{
    collections::VecDeque,
    io::IoSlice,
    os::fd::{AsFd, OwnedFd},
    sync::Arc,
};

use sm2_io::{Interest, SendError, SeqPacket};

/// What a socket has to carry: a frame, and the descriptor that goes with it.
#[derive(Debug)]
struct Parcel {
    frame: Vec<u8>,
    /// Shared if it is a file of counters: the kernel makes the duplicate when it is sent.
    fd: Option<Arc<OwnedFd>>,
}

impl Parcel {
    /// What it takes to keep it. A frame may be shorter than what keeps it.
    fn kept_bytes(&self) -> usize {
        size_of::<Self>() + self.frame.len()
    }
}

#[derive(Debug)]
pub(crate) struct Connection {
    pub(crate) socket: SeqPacket,
    /// What the socket is watched for.
    pub(crate) interest: Interest,
    waiting: VecDeque<Parcel>,
    waiting_bytes: usize,
    /// Descriptors sent since the node was last seen to have read all that was sent.
    sent_fds: usize,
    /// Nothing is kept for it any more: it is about to be closed.
    given_up: bool,
    /// The file of its counters, once it has handed that over.
    pub(crate) counters: Option<Arc<OwnedFd>>,
    /// Keeps the place of that file: without one the kernel would cut it off, and the node would
    /// be blamed for it.
    pub(crate) place: Option<OwnedFd>,
}

/// What became of a frame that is not lost.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Sent {
    /// The socket has it.
    Taken,
    /// It waits until the socket has room.
    Full,
    /// It waits until fewer of our descriptors are in flight, to whomever: the
    /// kernel counts them for their sender (`ETOOMANYREFS`).
    Crowded,
}

/// What the kernel counts for a datagram that is not read, at least.
const DATAGRAM_BYTES: usize = 512;

/// Why a node is given up.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Lost {
    /// Its end is closed; reading will say so.
    Closed,
    /// It does not read.
    Stalled,
}

impl Connection {
    pub(crate) const fn new(socket: SeqPacket, place: OwnedFd) -> Self {
        Self {
            socket,
            interest: Interest::READABLE,
            waiting: VecDeque::new(),
            waiting_bytes: 0,
            sent_fds: 0,
            given_up: false,
            counters: None,
            place: Some(place),
        }
    }

    /// How many descriptors are kept for it alone.
    pub(crate) fn waiting_fds(&self) -> usize {
        let fds = self.waiting.iter().filter_map(|parcel| parcel.fd.as_ref());
        fds.filter(|fd| Arc::strong_count(fd) == 1).count()
    }

    /// Lets go of all that is kept for it, and keeps nothing from now on.
    pub(crate) fn give_up(&mut self) {
        self.given_up = true;
        self.waiting = VecDeque::new();
        self.waiting_bytes = 0;
    }

    /// Whether the socket has to be watched for room.
    pub(crate) fn is_waiting(&self) -> bool {
        !self.waiting.is_empty()
    }

    /// Sends a frame now, or keeps it within `limit_bytes`.
    //= SM2-TRN-009
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

    /// Sends what was kept, as far as the socket takes it.
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

    /// How many descriptors it can have left unread at most: not more than it was sent since
    /// it had read everything, nor than there are datagrams.
    pub(crate) fn unread_fds(&mut self) -> usize {
        let unread_bytes = self.socket.unread_bytes().unwrap_or(0);
        if unread_bytes == 0 {
            self.sent_fds = 0;
        }
        self.sent_fds.min(unread_bytes / DATAGRAM_BYTES)
    }

    fn transmit(&mut self, parcel: &Parcel) -> Result<Sent, Lost> {
        if self.sent_fds > 0 {
            // Takes note if it has read everything up to now.
            self.unread_fds();
        }
        let sent = transmit(&self.socket, parcel)?;
        if parcel.fd.is_some() && sent == Sent::Taken {
            self.sent_fds += 1;
        }
        Ok(sent)
    }

    /// The last frame, if the socket takes it.
    //= SM2-SES-005
    pub(crate) fn say_goodbye(mut self, frame: Option<Vec<u8>>) {
        let Some(frame) = frame else { return };
        if self.flush() == Ok(Sent::Taken) {
            // Whoever does not take its goodbye finds the connection closed.
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
        //= SM2-TRN-010
        Err(SendError::TooManyInFlight) => Ok(Sent::Crowded),
        Err(SendError::Closed) => Err(Lost::Closed),
        Err(SendError::TooLong | SendError::Io(_)) => Err(Lost::Stalled),
    }
}
