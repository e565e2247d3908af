//! System calls on other processes.

use std::os::fd::{AsRawFd, BorrowedFd, FromRawFd, OwnedFd, RawFd};

use nix::errno::Errno;
use nix::libc;

use super::{Call, guard};

/// `SO_PEERPIDFD`, which `libc` does not have: the generic number, and that of SPARC.
const SO_PEERPIDFD: libc::c_int = match cfg!(any(target_arch = "sparc", target_arch = "sparc64")) {
    true => 0x56,
    false => 77,
};

/// `SO_PEERPIDFD`: a descriptor of the process that connected, close-on-exec.
pub(crate) fn peer_pidfd(fd: BorrowedFd<'_>) -> nix::Result<OwnedFd> {
    guard(Call::PidfdOpen)?;
    let mut number: RawFd = -1;
    let mut len_bytes = libc::socklen_t::try_from(size_of_val(&number)).unwrap_or_default();
    // SAFETY: the kernel writes at most `len_bytes` bytes to `number`; both live longer than the call, and `fd` is
    // borrowed, so it is open.
    let result = unsafe {
        libc::getsockopt(
            fd.as_raw_fd(),
            libc::SOL_SOCKET,
            SO_PEERPIDFD,
            (&raw mut number).cast(),
            &raw mut len_bytes,
        )
    };
    Errno::result(result)?;
    // SAFETY: the kernel has just returned this number: a new, open descriptor that nothing else owns.
    Ok(unsafe { OwnedFd::from_raw_fd(number) })
}

/// `pidfd_open(2)`: a descriptor of the process with this number, close-on-exec.
pub(crate) fn pidfd_open(pid: libc::pid_t) -> nix::Result<OwnedFd> {
    guard(Call::PidfdOpen)?;
    // SAFETY: the call takes two integers.
    let result = unsafe { libc::syscall(libc::SYS_pidfd_open, pid, 0) };
    let number = RawFd::try_from(Errno::result(result)?).map_err(|_| Errno::EOVERFLOW)?;
    // SAFETY: as in `peer_pidfd`.
    Ok(unsafe { OwnedFd::from_raw_fd(number) })
}
