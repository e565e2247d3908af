//! Errors that say that the kernel, the process or the user is short of something.

use std::io;

use nix::libc;

/// Whether a system call failed because descriptors, memory or room for more watched sockets is missing now.
/// The same call may succeed later.
#[must_use]
pub fn is_shortage(error: &io::Error) -> bool {
    matches!(
        error.raw_os_error(),
        Some(libc::EMFILE | libc::ENFILE | libc::ENOMEM | libc::ENOBUFS | libc::ENOSPC)
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_what_may_succeed_later_is_a_shortage() {
        let is_short = |errno| is_shortage(&io::Error::from_raw_os_error(errno));
        assert!(
            [
                libc::EMFILE,
                libc::ENFILE,
                libc::ENOMEM,
                libc::ENOBUFS,
                libc::ENOSPC
            ]
            .map(is_short)
                == [true; 5]
        );
        assert!([libc::EPIPE, libc::EBADF, libc::EACCES, libc::EAGAIN].map(is_short) == [false; 4]);
        assert!(
            !is_shortage(&io::ErrorKind::OutOfMemory.into()),
            "no system call"
        );
    }
}
