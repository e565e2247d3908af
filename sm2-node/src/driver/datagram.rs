//! Reading one datagram, and inspecting the descriptors that came with it.

use std::cell::Cell;
use std::io;
use std::os::fd::OwnedFd;

use sm2_io::{InspectedFd, RecvError, Scratch, SeqPacket};
use sm2_proto::FdFacts;
use sm2_proto::limits::DATAGRAM_MAX;

thread_local! {
    /// The buffer for the datagrams that this thread reads from links. Takes memory as far as it was used.
    static BUFFER: Cell<Option<Scratch>> = const { Cell::new(None) };
}

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
    // descriptor has no facts, and the machine refuses it. A descriptor whose facts find no memory
    // is lost, like one that finds no room.
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

/// Lends the thread's buffer for datagrams to `read`.
///
/// # Errors
///
/// Errors of `mmap(2)`, if this thread has no buffer yet.
pub(super) fn with_buffer<R>(read: impl FnOnce(&mut [u8]) -> R) -> io::Result<R> {
    // A handle that is dropped with other values of its thread may find the buffer gone.
    let kept = BUFFER.try_with(Cell::take).ok().flatten();
    let mut buffer = match kept {
        Some(buffer) => buffer,
        None => Scratch::new(DATAGRAM_MAX)?,
    };
    let result = read(&mut buffer);
    let _ = BUFFER.try_with(|kept| kept.set(Some(buffer)));
    Ok(result)
}
