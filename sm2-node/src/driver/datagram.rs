//! Reading one datagram, and inspecting the descriptors that came with it.

use std::io;
use std::os::fd::OwnedFd;

use sm2_io::{InspectedFd, RecvError, SeqPacket};
use sm2_proto::FdFacts;

/// A received datagram without its bytes. Dropping it closes the descriptors that were not taken.
#[derive(Debug, Default)]
pub(super) struct Incoming {
    pub(super) len: usize,
    pub(super) facts: Vec<FdFacts>,
    pub(super) data_truncated: bool,
    pub(super) control_truncated: bool,
    fds: Vec<InspectedFd>,
}

impl Incoming {
    /// Takes the descriptor of the frame.
    pub(super) fn take_fd(&mut self) -> Option<OwnedFd> {
        self.fds.pop().map(OwnedFd::from)
    }

    /// Takes the descriptor of the frame with the kernel's facts about it, for a file that will be
    /// mapped.
    pub(super) fn take_file(&mut self) -> Option<InspectedFd> {
        self.fds.pop()
    }
}

/// Reads one datagram. Allocates only if descriptors came.
pub(super) fn receive(socket: &SeqPacket, buffer: &mut [u8]) -> Result<Incoming, RecvError> {
    let received = socket.recv(buffer)?;
    // The kernel is asked before anything is mapped. If it does not answer for a descriptor, the
    // descriptor has no facts, and the machine refuses it. A descriptor for whose facts there is no
    // memory is lost, like one for which there is no room.
    let fds = received.fds.into_iter().map(InspectedFd::new);
    let fds: io::Result<Vec<_>> = fds.collect();
    let is_lost = fds.is_err();
    let fds = fds.unwrap_or_default();
    Ok(Incoming {
        len: received.len,
        facts: fds.iter().map(InspectedFd::facts).collect(),
        data_truncated: received.data_truncated,
        control_truncated: received.control_truncated || is_lost,
        fds,
    })
}
