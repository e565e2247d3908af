//! The process at the other end of a connection, its end, and the children of this process.

use std::io;
use std::os::fd::{AsFd, BorrowedFd, OwnedFd};

use nix::libc;

use crate::shortage::is_shortage;
use crate::socket::SeqPacket;
use crate::syscall::{files, fork, processes};

/// The process that made a connection.
///
/// The connection may outlive this process: a child that was made by `fork(2)` has the descriptor, too.
#[derive(Debug)]
pub enum PeerProcess {
    /// It was running. The descriptor becomes readable at its end.
    Running(ProcessFd),
    /// It has ended.
    Ended,
    /// The kernel does not tell: it is older than Linux 5.3, or a sandbox hides the process.
    Unknown,
}

/// A descriptor of a process (pidfd), close-on-exec. It is readable once the process has ended, also if its parent has
/// not waited for it.
#[derive(Debug)]
pub struct ProcessFd(OwnedFd);

/// Whether this process ignores a signal, as the kernel says: for example SIGHUP, if `nohup(1)` has started the
/// process.
#[must_use]
pub fn is_signal_ignored(number: i32) -> bool {
    let status = files::read_text("/proc/self/status").unwrap_or_default();
    let ignored = status.lines().find_map(|line| line.strip_prefix("SigIgn:"));
    let bits = ignored.and_then(|it| u64::from_str_radix(it.trim(), 16).ok());
    bits.is_some_and(|it| (1..=64).contains(&number) && it >> (number - 1) & 1 == 1)
}

/// The process that made a value, to tell it from a child that has a copy of the value, because it was made by
/// `fork(2)`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Maker(u64);

impl Maker {
    /// This process.
    #[must_use]
    pub fn this_process() -> Self {
        Self(fork::forks())
    }

    /// Whether this process is a child of the maker. Makes no system call, so it does not see that a child was made by
    /// `clone(2)` directly.
    #[must_use]
    pub fn is_parent(self) -> bool {
        self != Self::this_process()
    }
}

impl PeerProcess {
    /// The process that made this connection: by `SO_PEERPIDFD`, or before Linux 6.5 by the number of
    /// [`SeqPacket::peer_credentials`].
    ///
    /// If that number names another process by now, the descriptor becomes readable at the end of that one: later than
    /// the end of the process that connected.
    ///
    /// # Errors
    ///
    /// A lack of descriptors or memory ([`is_shortage`](crate::is_shortage)), and errors of `SO_PEERCRED`.
    pub fn of(socket: &SeqPacket) -> io::Result<Self> {
        let fd = match processes::peer_pidfd(socket.as_fd()).map_err(io::Error::from) {
            // The option is not known, or the kernel has forgotten the process.
            Err(error) if !is_shortage(&error) => match socket.peer_credentials()?.pid {
                // The process is in a PID namespace that this process cannot see.
                0 => return Ok(Self::Unknown),
                pid => processes::pidfd_open(pid).map_err(io::Error::from),
            },
            result => result,
        };
        match fd {
            Ok(fd) => Ok(Self::Running(ProcessFd(fd))),
            Err(error) if is_shortage(&error) => Err(error),
            Err(error) if error.raw_os_error() == Some(libc::ESRCH) => Ok(Self::Ended),
            Err(_) => Ok(Self::Unknown),
        }
    }
}

impl AsFd for ProcessFd {
    fn as_fd(&self) -> BorrowedFd<'_> {
        self.0.as_fd()
    }
}
