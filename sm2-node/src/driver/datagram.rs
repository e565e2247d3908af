//! Reading one datagram, and asking the kernel about the descriptors that came along.

use std::os::fd::OwnedFd;

use sm2_io::{InspectedFd, RecvError, SeqPacket};
use sm2_proto::FdFacts;

/// What came beside the bytes. Dropping it closes the descriptors that nobody took.
#[derive(Debug, Default)]
pub(super) struct Incoming {
    pub(super) len: usize,
    pub(super) facts: Vec<FdFacts>,
    pub(super) data_truncated: bool,
    pub(super) control_truncated: bool,
    fds: Vec<InspectedFd>,
}

impl Incoming {
    /// The descriptor that the frame carries, once.
    pub(super) fn take_fd(&mut self) -> Option<OwnedFd> {
        self.fds.pop().map(OwnedFd::from)
    }

    /// The same with the kernel's facts about it, for a file that will be mapped.
    pub(super) fn take_file(&mut self) -> Option<InspectedFd> {
        self.fds.pop()
    }
}

/// Reads one datagram. Allocates only if descriptors came.
pub(super) fn receive(socket: &SeqPacket, buffer: &mut [u8]) -> Result<Incoming, RecvError> {
    let received = socket.recv(buffer)?;
    // Asked before anything is mapped. A descriptor for which the kernel does not answer has no
    // facts, and the machine refuses it.
    let fds = received.fds.into_iter().map(InspectedFd::new);
    let fds: Vec<_> = fds.collect();
    Ok(Incoming {
        len: received.len,
        facts: fds.iter().map(InspectedFd::facts).collect(),
        data_truncated: received.data_truncated,
        control_truncated: received.control_truncated,
        fds,
    })
}
