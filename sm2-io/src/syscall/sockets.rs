//! System calls on sockets.

#[cfg(feature = "quic")]
use std::net::SocketAddr;
use std::os::fd::{AsFd, AsRawFd, BorrowedFd, FromRawFd, OwnedFd};

use nix::errno::Errno;
use nix::fcntl::{FcntlArg, FdFlag, OFlag, fcntl};
use nix::libc;
#[cfg(feature = "quic")]
use nix::sys::socket::SockaddrStorage;
use nix::sys::socket::{self, AddressFamily, GetSockOpt, SetSockOpt, SockFlag, SockType};
pub(crate) use nix::sys::socket::{UnixAddr, sockopt};

use super::{Call, guard};

const FLAGS: SockFlag = SockFlag::SOCK_CLOEXEC.union(SockFlag::SOCK_NONBLOCK);

/// A Unix seqpacket socket, close-on-exec, non-blocking.
pub(crate) fn seqpacket() -> nix::Result<OwnedFd> {
    guard(Call::Socket)?;
    socket::socket(AddressFamily::Unix, SockType::SeqPacket, FLAGS, None)
}

/// Two connected Unix seqpacket sockets, close-on-exec, non-blocking.
pub(crate) fn seqpacket_pair() -> nix::Result<(OwnedFd, OwnedFd)> {
    guard(Call::SocketPair)?;
    socket::socketpair(AddressFamily::Unix, SockType::SeqPacket, None, FLAGS)
}

pub(crate) fn connect(fd: BorrowedFd<'_>, address: &UnixAddr) -> nix::Result<()> {
    guard(Call::Connect)?;
    socket::connect(fd.as_raw_fd(), address)
}

pub(crate) fn bind(fd: BorrowedFd<'_>, address: &UnixAddr) -> nix::Result<()> {
    guard(Call::Bind)?;
    socket::bind(fd.as_raw_fd(), address)
}

pub(crate) fn listen(fd: BorrowedFd<'_>, backlog: i32) -> nix::Result<()> {
    guard(Call::Listen)?;
    socket::listen(&fd, socket::Backlog::new(backlog)?)
}

/// Accepts a connection, close-on-exec, non-blocking.
pub(crate) fn accept(fd: BorrowedFd<'_>) -> nix::Result<OwnedFd> {
    guard(Call::Accept)?;
    let number = socket::accept4(fd.as_raw_fd(), FLAGS)?;
    // SAFETY: `accept4` has just returned this number: a new, open descriptor that nothing else owns.
    Ok(unsafe { OwnedFd::from_raw_fd(number) })
}

pub(crate) fn get_option<O: GetSockOpt>(fd: impl AsFd, option: O) -> nix::Result<O::Val> {
    guard(Call::GetSockOpt)?;
    socket::getsockopt(&fd, option)
}

pub(crate) fn set_option<O: SetSockOpt>(
    fd: impl AsFd,
    option: O,
    value: &O::Val,
) -> nix::Result<()> {
    guard(Call::SetSockOpt)?;
    socket::setsockopt(&fd, option, value)
}

/// The cookie of the network namespace that a socket belongs to.
#[cfg(feature = "quic")]
pub(crate) fn network_namespace(fd: impl AsFd) -> nix::Result<u64> {
    guard(Call::GetSockOpt)?;
    let mut cookie = 0_u64;
    let mut len_bytes = libc::socklen_t::try_from(size_of_val(&cookie)).unwrap_or_default();
    // SAFETY: the kernel writes at most `len_bytes` bytes to `cookie`; both live longer than the call.
    let result = unsafe {
        libc::getsockopt(
            fd.as_fd().as_raw_fd(),
            libc::SOL_SOCKET,
            libc::SO_NETNS_COOKIE,
            (&raw mut cookie).cast(),
            &raw mut len_bytes,
        )
    };
    Errno::result(result)?;
    Ok(cookie)
}

/// A UDP socket at an address that other sockets have, too; close-on-exec, non-blocking. They all need the option
/// `SO_REUSEPORT`.
#[cfg(feature = "quic")]
pub(crate) fn udp_at_shared_address(address: SocketAddr) -> nix::Result<OwnedFd> {
    guard(Call::UdpBind)?;
    let family = match address {
        SocketAddr::V4(_) => AddressFamily::Inet,
        SocketAddr::V6(_) => AddressFamily::Inet6,
    };
    let socket = socket::socket(family, SockType::Datagram, FLAGS, None)?;
    socket::setsockopt(&socket, sockopt::ReusePort, &true)?;
    socket::bind(socket.as_raw_fd(), &SockaddrStorage::from(address))?;
    Ok(socket)
}

/// Makes the first of the UDP sockets that share the address of this one receive all datagrams.
#[cfg(feature = "quic")]
pub(crate) fn receive_with_first(fd: impl AsFd) -> nix::Result<()> {
    guard(Call::SetSockOpt)?;
    // The kernel runs this program for each datagram. Its result is the index of the socket.
    let mut first = [libc::sock_filter {
        code: (libc::BPF_RET | libc::BPF_K) as u16,
        jt: 0,
        jf: 0,
        k: 0,
    }];
    let program = libc::sock_fprog {
        len: 1,
        filter: first.as_mut_ptr(),
    };
    socket::setsockopt(&fd, sockopt::AttachReusePortCbpf, &program)
}

/// Whether the socket is a seqpacket socket.
pub(crate) fn is_seqpacket(fd: impl AsFd) -> nix::Result<bool> {
    Ok(get_option(fd, sockopt::SockType)? == SockType::SeqPacket)
}

/// The address of a Unix socket; an error for a socket of any other family.
pub(crate) fn unix_name(fd: impl AsFd) -> nix::Result<UnixAddr> {
    guard(Call::GetSockOpt)?;
    socket::getsockname(fd.as_fd().as_raw_fd())
}

/// `SO_PEERGROUPS`: the number of groups, and whether `gids` has room for them and holds them now.
pub(crate) fn peer_groups(
    fd: BorrowedFd<'_>,
    gids: &mut [libc::gid_t],
) -> nix::Result<(usize, bool)> {
    guard(Call::GetSockOpt)?;
    let room = size_of_val(gids);
    let mut len = libc::socklen_t::try_from(room).map_err(|_| Errno::EINVAL)?;
    // SAFETY: `gids` is writable for `len` bytes, and `len` outlives the call; `fd` is borrowed, so it is
    // open. The kernel writes at most `len` bytes of whole group ids; each bit pattern is a valid one.
    let result = unsafe {
        libc::getsockopt(
            fd.as_raw_fd(),
            libc::SOL_SOCKET,
            libc::SO_PEERGROUPS,
            gids.as_mut_ptr().cast(),
            &raw mut len,
        )
    };
    let count = len as usize / size_of::<libc::gid_t>();
    match Errno::result(result) {
        Ok(_) => Ok((count, true)),
        // The kernel states the length that it needs.
        Err(Errno::ERANGE) if count > gids.len() => Ok((count, false)),
        Err(error) => Err(error),
    }
}

/// Ends both directions.
pub(crate) fn shutdown(fd: BorrowedFd<'_>) -> nix::Result<()> {
    guard(Call::Shutdown)?;
    socket::shutdown(fd.as_raw_fd(), socket::Shutdown::Both)
}

/// Sets close-on-exec and non-blocking.
pub(crate) fn set_flags(fd: impl AsFd) -> nix::Result<()> {
    guard(Call::FcntlFlags)?;
    fcntl(&fd, FcntlArg::F_SETFD(FdFlag::FD_CLOEXEC))?;
    guard(Call::FcntlFlags)?;
    let flags = OFlag::from_bits_retain(fcntl(&fd, FcntlArg::F_GETFL)?);
    guard(Call::FcntlFlags)?;
    fcntl(&fd, FcntlArg::F_SETFL(flags | OFlag::O_NONBLOCK)).map(drop)
}

/// `SIOCOUTQ`
pub(crate) fn unread_bytes(fd: BorrowedFd<'_>) -> nix::Result<libc::c_int> {
    guard(Call::Ioctl)?;
    let mut bytes: libc::c_int = 0;
    // SAFETY: the request writes one `int`, and `bytes` is one that outlives the call; `fd` is borrowed,
    // so it is open.
    let result = unsafe { libc::ioctl(fd.as_raw_fd(), libc::TIOCOUTQ, &raw mut bytes) };
    Errno::result(result).map(|_| bytes)
}

/// Sends one datagram.
///
/// # Safety
///
/// `header` points to as many initialised iovecs and bytes of control data as it says.
pub(crate) unsafe fn sendmsg(
    fd: BorrowedFd<'_>,
    header: &libc::msghdr,
    flags: libc::c_int,
) -> nix::Result<()> {
    guard(Call::SendMsg)?;
    // SAFETY: `fd` is open, the header is a reference, and the caller promises what it points to, which
    // `sendmsg` only reads.
    let sent = unsafe { libc::sendmsg(fd.as_raw_fd(), std::ptr::from_ref(header), flags) };
    Errno::result(sent).map(drop)
}

/// Receives one datagram. Returns its length.
///
/// # Safety
///
/// `header` points to as much writable memory as it says, and nothing else uses that memory meanwhile.
pub(crate) unsafe fn recvmsg(
    fd: BorrowedFd<'_>,
    header: &mut libc::msghdr,
    flags: libc::c_int,
) -> nix::Result<usize> {
    guard(Call::RecvMsg)?;
    // SAFETY: `fd` is open, the header is borrowed exclusively, and the caller promises what it points to.
    let got = unsafe { libc::recvmsg(fd.as_raw_fd(), std::ptr::from_mut(header), flags) };
    Errno::result(got).map(isize::cast_unsigned)
}
