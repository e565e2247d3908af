//! Reading one datagram, and asking the kernel about the descriptors that came along.

use std::os::fd::{AsFd, OwnedFd};

use sm2_io::{RecvError, SeqPacket, memfd};
use sm2_proto::FdFacts;

/// What came beside the bytes. Dropping it closes the descriptors that nobody took.
#[derive(Debug, Default)]
pub(super) struct Incoming {
    pub(super) len: usize,
    pub(super) facts: Vec<FdFacts>,
    pub(super) data_truncated: bool,
    pub(super) control_truncated: bool,
    fds: Vec<OwnedFd>,
}

impl Incoming {
    /// The descriptor that the frame carries, once.
    pub(super) fn take_fd(&mut self) -> Option<OwnedFd> {
        self.fds.pop()
    }
}

/// Reads one datagram. Allocates only if descriptors came.
pub(super) fn receive(socket: &SeqPacket, buffer: &mut [u8]) -> Result<Incoming, RecvError> {
    let received = socket.recv(buffer)?;
    // Asked before anything is mapped. What the kernel does not answer for is no memory
    // file: no facts, and the machine refuses it.
    let facts = |fd: &OwnedFd| memfd::facts(fd.as_fd()).unwrap_or_default();
    Ok(Incoming {
        len: received.len,
        facts: received.fds.iter().map(facts).collect(),
        data_truncated: received.data_truncated,
        control_truncated: received.control_truncated,
        fds: received.fds.into_vec(),
    })
}
