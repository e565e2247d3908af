//! Waiting until one of many descriptors is ready.

use std::io;
use std::os::fd::{AsFd, BorrowedFd};
use std::time::Duration;

use nix::errno::Errno;

use crate::syscall::events::{self, EpollEvent, EpollFlags, EpollTimeout, PollFd, PollFlags};

/// Upper bound for a timeout (34 years), which the kernel can represent.
const LONGEST: Duration = Duration::from_secs(1 << 30);

/// The events to wait for. Hang-ups and errors are always reported.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub struct Interest {
    /// A read does not block: there is data, or the peer has closed.
    pub readable: bool,
    /// A write does not block.
    pub writable: bool,
    /// Edge-triggered (`EPOLLET`): reports a change once.
    pub edge: bool,
}

impl Interest {
    /// Only hang-ups and errors.
    pub const NONE: Self = Self {
        readable: false,
        writable: false,
        edge: false,
    };
    /// Readable, level-triggered.
    pub const READABLE: Self = Self {
        readable: true,
        ..Self::NONE
    };
    /// Writable, level-triggered.
    pub const WRITABLE: Self = Self {
        writable: true,
        ..Self::NONE
    };
    /// Readable or writable, level-triggered.
    pub const BOTH: Self = Self {
        readable: true,
        writable: true,
        edge: false,
    };

    /// The same, edge-triggered.
    #[must_use]
    pub const fn edge(self) -> Self {
        Self { edge: true, ..self }
    }

    fn flags(self) -> EpollFlags {
        let mut flags = EpollFlags::empty();
        flags.set(EpollFlags::EPOLLIN | EpollFlags::EPOLLRDHUP, self.readable);
        flags.set(EpollFlags::EPOLLOUT, self.writable);
        flags.set(EpollFlags::EPOLLET, self.edge);
        flags
    }
}

/// A set of descriptors to wait for. Its own descriptor is readable while an
/// event is pending, so one set can be watched by another.
///
/// A descriptor leaves the set when it is [removed](Self::remove), or when
/// its last duplicate in any process is closed: remove those that were shared.
#[derive(Debug)]
pub struct Epoll {
    epoll: events::Epoll,
}

impl Epoll {
    /// An empty set.
    ///
    /// # Errors
    ///
    /// Any error of `epoll_create1(2)`, such as too many descriptors or no memory.
    pub fn new() -> io::Result<Self> {
        let epoll = events::epoll_create()?;
        Ok(Self { epoll })
    }

    /// Watches `fd`, whose events carry `token`.
    ///
    /// # Errors
    ///
    /// `AlreadyExists` if `fd` is watched already, `PermissionDenied` if epoll does not support its
    /// kind (a regular file), out of memory.
    pub fn add(&self, fd: impl AsFd, token: u64, interest: Interest) -> io::Result<()> {
        let event = EpollEvent::new(interest.flags(), token);
        Ok(events::epoll_add(&self.epoll, fd, event)?)
    }

    /// Changes the token and the interest of `fd`.
    ///
    /// # Errors
    ///
    /// `NotFound` if it is not watched.
    pub fn modify(&self, fd: impl AsFd, token: u64, interest: Interest) -> io::Result<()> {
        let mut event = EpollEvent::new(interest.flags(), token);
        Ok(events::epoll_modify(&self.epoll, fd, &mut event)?)
    }

    /// Stops watching `fd`.
    ///
    /// # Errors
    ///
    /// `NotFound` if it is not watched.
    pub fn remove(&self, fd: impl AsFd) -> io::Result<()> {
        Ok(events::epoll_remove(&self.epoll, fd)?)
    }

    /// Waits for an event for at most `timeout` (`None`: no limit), and replaces the content of
    /// `events`. Returns early without an event only after a signal, so that the caller can handle
    /// the signal.
    ///
    /// # Errors
    ///
    /// None are expected: the descriptor and the buffer are valid.
    pub fn wait(&self, events: &mut Events, timeout: Option<Duration>) -> io::Result<()> {
        let Events { buffer, filled } = events;
        *filled = 0;
        let exact = timeout.map(|timeout| timeout.min(LONGEST));
        let result = match events::epoll_pwait2(&self.epoll, buffer, exact) {
            // Before Linux 5.11, or filtered out by a sandbox that does not know it.
            Err(Errno::ENOSYS | Errno::EPERM) => {
                events::epoll_wait(&self.epoll, buffer, whole_millis(timeout))
            }
            result => result,
        };
        match result {
            Ok(count) => *filled = count,
            Err(Errno::EINTR) => {}
            Err(errno) => return Err(errno.into()),
        }
        Ok(())
    }
}

impl AsFd for Epoll {
    fn as_fd(&self) -> BorrowedFd<'_> {
        self.epoll.0.as_fd()
    }
}

/// The timeout rounded up: a caller that wakes early would have to wait again.
fn whole_millis(timeout: Option<Duration>) -> EpollTimeout {
    let Some(timeout) = timeout else {
        return EpollTimeout::NONE;
    };
    let millis = timeout.as_nanos().div_ceil(1_000_000);
    EpollTimeout::try_from(millis).unwrap_or(EpollTimeout::MAX)
}

/// A buffer for the events of one [wait](Epoll::wait). The next wait reports the events that do
/// not fit.
#[derive(Debug)]
pub struct Events {
    buffer: Vec<EpollEvent>,
    filled: usize,
}

impl Events {
    /// A buffer for `capacity` events, at least one.
    #[must_use]
    pub fn with_capacity(capacity: usize) -> Self {
        Self {
            buffer: vec![EpollEvent::empty(); capacity.max(1)],
            filled: 0,
        }
    }

    /// The events of the last wait.
    pub fn iter(&self) -> impl ExactSizeIterator<Item = Event> + '_ {
        self.buffer[..self.filled].iter().map(Event::from)
    }

    /// The number of events of the last wait.
    #[must_use]
    pub const fn len(&self) -> usize {
        self.filled
    }

    /// Whether the last wait ended without an event.
    #[must_use]
    pub const fn is_empty(&self) -> bool {
        self.filled == 0
    }
}

/// The state of one descriptor.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct Event {
    /// As given to [`Epoll::add`].
    pub token: u64,
    /// Reading does not block. Also set after a hang-up or an error, which a read reports.
    pub readable: bool,
    /// Writing does not block.
    pub writable: bool,
    /// The peer has closed, or will send no more, or there is an error. Data that the peer sent
    /// before can still be read.
    pub hangup: bool,
}

impl From<&EpollEvent> for Event {
    fn from(event: &EpollEvent) -> Self {
        let flags = event.events();
        let hangup =
            flags.intersects(EpollFlags::EPOLLHUP | EpollFlags::EPOLLERR | EpollFlags::EPOLLRDHUP);
        Self {
            token: event.data(),
            readable: hangup || flags.contains(EpollFlags::EPOLLIN),
            writable: flags.contains(EpollFlags::EPOLLOUT),
            hangup,
        }
    }
}

/// Looks at `fd` without waiting. Returns whether it is readable, and whether it is writable, as in
/// an [`Event`]; only for what `interest` names, but hang-ups and errors are always readable.
///
/// # Errors
///
/// Any error of `ppoll(2)`, such as no memory.
pub fn poll_now(fd: BorrowedFd<'_>, interest: Interest) -> io::Result<(bool, bool)> {
    let mut flags = PollFlags::empty();
    flags.set(PollFlags::POLLIN, interest.readable);
    flags.set(PollFlags::POLLOUT, interest.writable);
    let mut fds = [PollFd::new(fd, flags)];
    events::poll(&mut fds, Some(Duration::ZERO))?;
    let seen = fds[0].revents().unwrap_or(PollFlags::empty());
    let readable = PollFlags::POLLIN | PollFlags::POLLHUP | PollFlags::POLLERR;
    Ok((seen.intersects(readable), seen.contains(PollFlags::POLLOUT)))
}

/// Waits until at least one of `fds` is readable or hung up, for at most `timeout` (`None`: no
/// limit). For callers without an [`Epoll`] of their own. Allocates only for more than eight
/// descriptors.
///
/// Returns `false` after the timeout or a signal; the clock tells which.
///
/// # Errors
///
/// Any error of `ppoll(2)`, such as no memory or more descriptors than `RLIMIT_NOFILE`.
pub fn wait_readable(fds: &[BorrowedFd<'_>], timeout: Option<Duration>) -> io::Result<bool> {
    let timeout = timeout.map(|timeout| timeout.min(LONGEST));
    let result = match fds {
        [] => events::poll(&mut [], timeout),
        [first, ..] if fds.len() <= 8 => {
            let mut few: [PollFd<'_>; 8] =
                std::array::from_fn(|index| watch(*fds.get(index).unwrap_or(first)));
            events::poll(&mut few[..fds.len()], timeout)
        }
        _ => {
            let mut many: Vec<_> = fds.iter().copied().map(watch).collect();
            events::poll(&mut many, timeout)
        }
    };
    match result {
        Ok(count) => Ok(count > 0),
        Err(Errno::EINTR) => Ok(false),
        Err(errno) => Err(errno.into()),
    }
}

fn watch(fd: BorrowedFd<'_>) -> PollFd<'_> {
    PollFd::new(fd, PollFlags::POLLIN)
}
