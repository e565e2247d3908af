//! The side whose fault it is that a received descriptor cannot be used.

use std::io;

use nix::libc;

/// A side of a link.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Side {
    /// The process that sent the descriptor.
    Sender,
    /// This process, its user, or the machine.
    Receiver,
}

/// The side that causes an error of inspecting, proving or mapping a received descriptor.
///
/// | error | side | cause |
/// | --- | --- | --- |
/// | `EMFILE`, `ENFILE` | receiver | no descriptor is free |
/// | `ENOMEM`, `ENOBUFS`, `ENOSPC` | receiver | no memory or no mapping is free |
/// | `EAGAIN` | receiver | `mlockall(2)` with `MCL_FUTURE` holds as much memory as the process may lock |
/// | `EINTR` | receiver | a signal came |
/// | `EACCES`, `EPERM` | sender | the file is not open for the access that the mapping needs |
/// | `EBADF`, `EINVAL`, `ENODEV`, `EOVERFLOW` and all others | sender | the file is of another kind or size |
/// | an error that no system call reports, such as [`VerifyError`](super::VerifyError) | sender | as above |
#[must_use]
pub fn blame(error: &io::Error) -> Side {
    match error.raw_os_error() {
        Some(
            libc::EMFILE
            | libc::ENFILE
            | libc::ENOMEM
            | libc::ENOBUFS
            | libc::ENOSPC
            | libc::EAGAIN
            | libc::EINTR,
        ) => Side::Receiver,
        _ => Side::Sender,
    }
}
