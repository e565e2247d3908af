//! The kinds of system calls.

/// One kind of system call.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
#[cfg_attr(
    not(feature = "fault-injection"),
    allow(dead_code, unreachable_pub, reason = "the names are for tests")
)]
pub enum Call {
    /// `socket(2)`
    Socket,
    /// `socketpair(2)`
    SocketPair,
    /// `connect(2)`
    Connect,
    /// `bind(2)`
    Bind,
    /// `listen(2)`
    Listen,
    /// `accept4(2)`
    Accept,
    /// `getsockopt(2)`, `getsockname(2)`
    GetSockOpt,
    /// `setsockopt(2)`
    SetSockOpt,
    /// `pidfd_open(2)`, `getsockopt(2)` of `SO_PEERPIDFD`
    PidfdOpen,
    /// `shutdown(2)`
    Shutdown,
    /// `sendmsg(2)`
    SendMsg,
    /// `recvmsg(2)`
    RecvMsg,
    /// `ioctl(2)`
    Ioctl,
    /// `fcntl(2)` for flags
    FcntlFlags,
    /// `fcntl(2)` that reads seals
    GetSeals,
    /// `fcntl(2)` that adds seals
    AddSeals,
    /// `fcntl(2)` that duplicates a descriptor
    Dup,
    /// `epoll_create1(2)`
    EpollCreate,
    /// `epoll_ctl(2)`
    EpollCtl,
    /// `epoll_pwait2(2)`, `epoll_wait(2)`
    EpollWait,
    /// `ppoll(2)`
    Poll,
    /// `eventfd(2)`
    EventFd,
    /// `timerfd_create(2)`
    TimerCreate,
    /// `timerfd_settime(2)`
    TimerSet,
    /// `memfd_create(2)`
    MemfdCreate,
    /// `ftruncate(2)`
    Truncate,
    /// `fallocate(2)`
    Allocate,
    /// `pwrite(2)`
    Write,
    /// `pread(2)`
    Read,
    /// `lseek(2)`
    Seek,
    /// `fstat(2)`, `stat(2)`, `lstat(2)`, `fstatfs(2)`
    Stat,
    /// `getrlimit(2)`
    GetLimit,
    /// `sched_setscheduler(2)`
    SetScheduler,
    /// `mmap(2)`
    Mmap,
    /// `madvise(2)`
    Advise,
    /// `mlock(2)`
    Lock,
    /// `open(2)`
    Open,
    /// `flock(2)`
    FileLock,
    /// `unlink(2)`
    Unlink,
    /// `rename(2)`
    Rename,
    /// `chmod(2)`
    Chmod,
    /// `mkdir(2)`
    Mkdir,
    /// Making the UDP socket of a gateway
    UdpBind,
    /// Sending datagrams of QUIC
    UdpSend,
    /// Receiving datagrams of QUIC
    UdpRecv,
}

#[cfg(feature = "fault-injection")]
impl Call {
    /// All kinds.
    pub const ALL: [Self; 45] = [
        Self::Socket,
        Self::SocketPair,
        Self::Connect,
        Self::Bind,
        Self::Listen,
        Self::Accept,
        Self::GetSockOpt,
        Self::SetSockOpt,
        Self::PidfdOpen,
        Self::Shutdown,
        Self::SendMsg,
        Self::RecvMsg,
        Self::Ioctl,
        Self::FcntlFlags,
        Self::GetSeals,
        Self::AddSeals,
        Self::Dup,
        Self::EpollCreate,
        Self::EpollCtl,
        Self::EpollWait,
        Self::Poll,
        Self::EventFd,
        Self::TimerCreate,
        Self::TimerSet,
        Self::MemfdCreate,
        Self::Truncate,
        Self::Allocate,
        Self::Write,
        Self::Read,
        Self::Seek,
        Self::Stat,
        Self::GetLimit,
        Self::SetScheduler,
        Self::Mmap,
        Self::Advise,
        Self::Lock,
        Self::Open,
        Self::FileLock,
        Self::Unlink,
        Self::Rename,
        Self::Chmod,
        Self::Mkdir,
        Self::UdpBind,
        Self::UdpSend,
        Self::UdpRecv,
    ];
}
