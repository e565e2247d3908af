//! One node's connection: its socket and what the socket did not take yet.

use std::{collections::VecDeque, io::IoSlice, os::fd::AsFd, os::fd::OwnedFd};

use sm2_io::{SendError, SeqPacket};

/// What a socket has to carry: a frame, and the descriptor that goes with it.
#[derive(Debug)]
struct Parcel {
    frame: Vec<u8>,
    fd: Option<OwnedFd>,
}

#[derive(Debug)]
pub(crate) struct Connection {
    pub(crate) socket: SeqPacket,
    waiting: VecDeque<Parcel>,
    waiting_bytes: usize,
}

/// Why a node is given up.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Lost {
    /// Its end is closed; reading will say so.
    Closed,
    /// It does not read.
    Stalled,
}

impl Connection {
    pub(crate) const fn new(socket: SeqPacket) -> Self {
        Self {
            socket,
            waiting: VecDeque::new(),
            waiting_bytes: 0,
        }
    }

    /// Whether the socket has to be watched for room.
    pub(crate) fn is_waiting(&self) -> bool {
        !self.waiting.is_empty()
    }

    /// Sends a frame now, or keeps it within `limit_bytes`.
    //= SM2-TRN-009, SM2-TRN-010
    pub(crate) fn send(
        &mut self,
        frame: Vec<u8>,
        fd: Option<OwnedFd>,
        limit_bytes: usize,
    ) -> Result<(), Lost> {
        let parcel = Parcel { frame, fd };
        if self.waiting.is_empty() && transmit(&self.socket, &parcel)? {
            return Ok(());
        }
        self.waiting_bytes += parcel.frame.len();
        if self.waiting_bytes > limit_bytes {
            return Err(Lost::Stalled);
        }
        self.waiting.push_back(parcel);
        Ok(())
    }

    /// Sends what was kept, as far as the socket takes it.
    pub(crate) fn flush(&mut self) -> Result<(), Lost> {
        while let Some(parcel) = self.waiting.front() {
            if !transmit(&self.socket, parcel)? {
                return Ok(());
            }
            self.waiting_bytes -= parcel.frame.len();
            self.waiting.pop_front();
        }
        Ok(())
    }

    /// The last frame, if the socket takes it.
    //= SM2-SES-005
    pub(crate) fn say_goodbye(mut self, frame: Option<Vec<u8>>) {
        let Some(frame) = frame else { return };
        if self.flush().is_ok() && self.waiting.is_empty() {
            // Whoever does not take its goodbye finds the connection closed.
            let _ = transmit(&self.socket, &Parcel { frame, fd: None });
        }
    }
}

/// Whether the socket took it; `false` if it has no room.
fn transmit(socket: &SeqPacket, parcel: &Parcel) -> Result<bool, Lost> {
    let parts = [IoSlice::new(&parcel.frame)];
    let result = match &parcel.fd {
        Some(fd) => socket.send(&parts, &[fd.as_fd()]),
        None => socket.send(&parts, &[]),
    };
    match result {
        Ok(()) => Ok(true),
        Err(SendError::WouldBlock) => Ok(false),
        Err(SendError::Closed) => Err(Lost::Closed),
        Err(SendError::TooManyInFlight | SendError::TooLong | SendError::Io(_)) => {
            Err(Lost::Stalled)
        }
    }
}
