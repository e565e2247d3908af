//! Datagrams with descriptors between two sockets of this process.

use std::io::{self, IoSlice};
use std::os::fd::{AsFd, AsRawFd, OwnedFd};

use nix::errno::Errno;
use nix::fcntl::{FcntlArg, FdFlag, OFlag, fcntl};
use nix::sys::socket::{self, AddressFamily, MsgFlags, SockFlag, SockType};
use nix::sys::stat::fstat;
use sm2_io::{Listener, RecvError, SendError, SeqPacket};

fn send(socket: &SeqPacket, bytes: &[u8]) -> Result<(), SendError> {
    socket.send(&[IoSlice::new(bytes)], &[])
}

/// Returns the bytes and the descriptors of the next datagram.
fn recv(socket: &SeqPacket) -> Result<(Vec<u8>, Vec<OwnedFd>), RecvError> {
    let mut buffer = [0; 256];
    let received = socket.recv(&mut buffer)?;
    assert!(!received.data_truncated && !received.control_truncated);
    Ok((buffer[..received.len].to_vec(), received.fds.into_vec()))
}

fn inode(fd: impl AsFd) -> (u64, u64) {
    let stat = fstat(fd).unwrap();
    (stat.st_dev, stat.st_ino)
}

#[test]
fn parts_arrive_as_one_datagram_and_datagrams_stay_apart() {
    let (a, b) = SeqPacket::pair().unwrap();
    let parts = [&b"he"[..], b"", b"llo"].map(IoSlice::new);
    a.send(&parts, &[]).unwrap();
    send(&a, b"next").unwrap();
    let (bytes, fds) = recv(&b).unwrap();
    assert_eq!((&bytes[..], fds.len()), (&b"hello"[..], 0));
    assert_eq!(recv(&b).unwrap().0, b"next");
    assert!(matches!(recv(&b), Err(RecvError::WouldBlock)));
}

#[test]
fn descriptors_arrive_in_order_and_close_on_exec() {
    let (a, b) = SeqPacket::pair().unwrap();
    let files: Vec<_> = (0..5).map(|_| tempfile::tempfile().unwrap()).collect();
    let borrowed: Vec<_> = files.iter().map(AsFd::as_fd).collect();
    for count in [1, 2, 5] {
        a.send(&[IoSlice::new(b"x")], &borrowed[..count]).unwrap();
        let (_, fds) = recv(&b).unwrap();
        let sent: Vec<_> = files[..count].iter().map(inode).collect();
        assert_eq!(fds.iter().map(inode).collect::<Vec<_>>(), sent);
        for fd in &fds {
            let flags = FdFlag::from_bits_retain(fcntl(fd, FcntlArg::F_GETFD).unwrap());
            assert!(flags.contains(FdFlag::FD_CLOEXEC));
        }
    }
}

#[test]
fn as_many_descriptors_as_the_kernel_passes_and_not_one_more() {
    let (a, b) = SeqPacket::pair().unwrap();
    let file = tempfile::tempfile().unwrap();
    let byte = [IoSlice::new(b"x")];
    let Err(SendError::Io(error)) = a.send(&byte, &vec![file.as_fd(); 254]) else {
        panic!("254 descriptors were accepted");
    };
    assert_eq!(error.kind(), io::ErrorKind::InvalidInput);
    assert!(matches!(recv(&b), Err(RecvError::WouldBlock)));

    a.send(&byte, &vec![file.as_fd(); 253]).unwrap();
    let (_, fds) = recv(&b).unwrap();
    assert_eq!(fds.len(), 253);
    assert!(fds.iter().all(|fd| inode(fd) == inode(&file)));
}

#[test]
fn an_empty_datagram_is_never_sent_and_ends_the_connection_when_received() {
    let (a, b) = SeqPacket::pair().unwrap();
    for parts in [&[][..], &[IoSlice::new(b""), IoSlice::new(b"")]] {
        let Err(SendError::Io(error)) = a.send(parts, &[]) else {
            panic!("an empty datagram was sent");
        };
        assert_eq!(error.kind(), io::ErrorKind::InvalidInput);
    }
    assert!(matches!(recv(&b), Err(RecvError::WouldBlock)));
    socket::send(a.as_fd().as_raw_fd(), b"", MsgFlags::empty()).unwrap();
    assert!(matches!(recv(&b), Err(RecvError::Closed)));
}

#[test]
fn a_longer_datagram_is_marked_truncated() {
    let (a, b) = SeqPacket::pair().unwrap();
    for room in [0, 3] {
        send(&a, b"hello").unwrap();
        let received = b.recv(&mut [0; 3][..room]).unwrap();
        assert!(received.data_truncated && received.len == room);
    }
    send(&a, b"abc").unwrap();
    assert!(!b.recv(&mut [0; 3]).unwrap().data_truncated);
}

#[test]
fn a_full_socket_would_block_and_frees_itself_by_reading() {
    let (a, b) = SeqPacket::pair().unwrap();
    let mut sent = 0_u32;
    let error = loop {
        match send(&a, &[7; 100]) {
            Ok(()) => sent += 1,
            Err(error) => break error,
        }
    };
    assert!(matches!(error, SendError::WouldBlock) && sent > 10);
    for _ in 0..sent {
        assert_eq!(recv(&b).unwrap().0, [7; 100]);
    }
    send(&a, b"again").unwrap();
}

#[test]
fn a_datagram_larger_than_the_send_buffer_is_too_long() {
    let (a, _b) = SeqPacket::pair().unwrap();
    a.set_send_buffer_bytes(100_000).unwrap();
    assert!(matches!(
        send(&a, &vec![0; 1 << 20]),
        Err(SendError::TooLong)
    ));
    send(&a, &[0; 65_536]).unwrap();
}

#[test]
fn closing_is_seen_by_both_directions() {
    let (a, b) = SeqPacket::pair().unwrap();
    send(&a, b"last words").unwrap();
    drop(a);
    assert_eq!(recv(&b).unwrap().0, b"last words");
    assert!(matches!(recv(&b), Err(RecvError::Closed)));
    assert!(matches!(recv(&b), Err(RecvError::Closed)));
    assert!(matches!(send(&b, b"x"), Err(SendError::Closed)));
}

#[test]
fn a_connection_can_be_ended_for_all_duplicates() {
    let (a, b) = SeqPacket::pair().unwrap();
    let duplicate = SeqPacket::from_fd(a.as_fd().try_clone_to_owned().unwrap()).unwrap();
    send(&a, b"last words").unwrap();
    a.shutdown().unwrap();
    assert!(matches!(send(&duplicate, b"x"), Err(SendError::Closed)));
    assert!(matches!(recv(&duplicate), Err(RecvError::Closed)));
    assert_eq!(recv(&b).unwrap().0, b"last words");
    assert!(matches!(recv(&b), Err(RecvError::Closed)));
}

/// Returns a socket whose peer has closed without reading all of our datagrams. Two of the peer's datagrams
/// are queued, the second one with a descriptor.
fn closed_with_unread_data() -> SeqPacket {
    let (a, b) = SeqPacket::pair().unwrap();
    let file = tempfile::tempfile().unwrap();
    send(&a, b"first").unwrap();
    a.send(&[IoSlice::new(b"second")], &[file.as_fd()]).unwrap();
    send(&b, b"never read").unwrap();
    drop(a);
    b
}

#[test]
fn a_reset_does_not_hide_what_was_queued() {
    // Checks that the kernel reports a reset here, so that the following lines test it.
    let b = closed_with_unread_data();
    let mut buffer = [0; 16];
    let flags = MsgFlags::empty();
    let first = socket::recv(b.as_fd().as_raw_fd(), &mut buffer, flags);
    assert_eq!(first, Err(Errno::ECONNRESET));

    let b = closed_with_unread_data();
    let (bytes, fds) = recv(&b).unwrap();
    assert_eq!((&bytes[..], fds.len()), (&b"first"[..], 0));
    let (bytes, fds) = recv(&b).unwrap();
    assert_eq!((&bytes[..], fds.len()), (&b"second"[..], 1));
    assert!(matches!(recv(&b), Err(RecvError::Closed)));

    // Sending first receives the reset; again no datagram is lost.
    let b = closed_with_unread_data();
    assert!(matches!(send(&b, b"x"), Err(SendError::Closed)));
    assert_eq!(recv(&b).unwrap().0, b"first");
    assert_eq!(recv(&b).unwrap().1.len(), 1);
    assert!(matches!(recv(&b), Err(RecvError::Closed)));
}

#[test]
fn only_unix_seqpacket_sockets_are_adopted() {
    let pair = |kind| {
        let flags = SockFlag::empty();
        socket::socketpair(AddressFamily::Unix, kind, None, flags).unwrap()
    };
    let tcp = std::net::TcpListener::bind("127.0.0.1:0").unwrap();
    let others: [OwnedFd; 5] = [
        pair(SockType::Stream).0,
        pair(SockType::Datagram).0,
        tempfile::tempfile().unwrap().into(),
        nix::unistd::pipe().unwrap().0,
        tcp.into(),
    ];
    for fd in others {
        let error = SeqPacket::from_fd(fd).unwrap_err();
        assert_eq!(error.kind(), io::ErrorKind::InvalidInput);
    }
    let (a, b) = pair(SockType::SeqPacket);
    let (a, b) = (
        SeqPacket::from_fd(a).unwrap(),
        SeqPacket::from_fd(b).unwrap(),
    );
    let fd_flags = FdFlag::from_bits_retain(fcntl(&a, FcntlArg::F_GETFD).unwrap());
    let flags = OFlag::from_bits_retain(fcntl(&a, FcntlArg::F_GETFL).unwrap());
    assert!(fd_flags.contains(FdFlag::FD_CLOEXEC) && flags.contains(OFlag::O_NONBLOCK));
    send(&a, b"works").unwrap();
    assert_eq!(recv(&b).unwrap().0, b"works");
    assert!(Listener::from_fd(a.into()).is_err());
    let b = SeqPacket::from_fd(b.into()).unwrap();
    let flags = OFlag::from_bits_retain(fcntl(&b, FcntlArg::F_GETFL).unwrap());
    assert!(flags.contains(OFlag::O_NONBLOCK), "once more");
}

/// The non-blocking flag belongs to all duplicates, including those of other processes.
#[test]
fn nothing_blocks_although_another_holder_cleared_the_flag() {
    let (a, b) = SeqPacket::pair().unwrap();
    for end in [&a, &b] {
        fcntl(end, FcntlArg::F_SETFL(OFlag::empty())).unwrap();
    }
    assert!(matches!(recv(&b), Err(RecvError::WouldBlock)));
    while send(&a, &[0; 1000]).is_ok() {}
}

#[test]
fn a_socket_that_is_not_connected_is_closed() {
    let flags = SockFlag::empty();
    let fd = socket::socket(AddressFamily::Unix, SockType::SeqPacket, flags, None).unwrap();
    let socket = SeqPacket::from_fd(fd).unwrap();
    assert!(matches!(recv(&socket), Err(RecvError::Closed)));
    assert!(matches!(send(&socket, b"x"), Err(SendError::Closed)));
}

#[test]
fn a_listener_accepts_who_connects_and_knows_who_it_is() {
    let directory = tempfile::tempdir().unwrap();
    let path = directory.path().join("s");
    let connect = || SeqPacket::connect(&path);
    assert_eq!(connect().unwrap_err().kind(), io::ErrorKind::NotFound);

    let listener = Listener::bind(&path, 16).unwrap();
    let again = Listener::bind(&path, 16).unwrap_err();
    assert_eq!(again.kind(), io::ErrorKind::AddrInUse);
    assert!(listener.accept().unwrap().is_none());
    let client = connect().unwrap();
    let server = listener.accept().unwrap().unwrap();
    assert!(listener.accept().unwrap().is_none());
    send(&client, b"hello").unwrap();
    assert_eq!(recv(&server).unwrap().0, b"hello");
    for end in [&client, &server] {
        let peer = end.peer_credentials().unwrap();
        assert_eq!(peer.pid.cast_unsigned(), std::process::id());
        assert_eq!(peer.uid, nix::unistd::geteuid().as_raw());
        assert_eq!(peer.gid, nix::unistd::getegid().as_raw());
        let flags = FdFlag::from_bits_retain(fcntl(end, FcntlArg::F_GETFD).unwrap());
        assert!(flags.contains(FdFlag::FD_CLOEXEC));
    }

    let listener = Listener::from_fd(listener.into()).unwrap();
    let _client = connect().unwrap();
    assert!(listener.accept().unwrap().is_some());
    drop(listener);
    assert_eq!(
        connect().unwrap_err().kind(),
        io::ErrorKind::ConnectionRefused
    );
}

/// The further groups that the kernel states for the process at the other end of a pair.
fn groups_of_a_pair() -> Vec<u32> {
    let (one, _other) = SeqPacket::pair().unwrap();
    let mut gids = one.peer_groups().unwrap();
    gids.sort_unstable();
    gids
}

#[test]
fn the_groups_of_the_peer_are_all_told() {
    let own = nix::unistd::getgroups().unwrap();
    let mut own: Vec<u32> = own.iter().map(|it| it.as_raw()).collect();
    own.sort_unstable();
    assert_eq!(groups_of_a_pair(), own);
    if !nix::unistd::geteuid().is_root() {
        return sm2_test_support::skip("only root can change its groups");
    }
    // More groups than the first buffer holds. The system call itself changes the groups of one thread.
    for count in [0, 1, 32, 33, 5_000] {
        let gids: Vec<u32> = (100_000..100_000 + count).collect();
        let told = std::thread::spawn(move || {
            // SAFETY: the list is readable for its length, and outlives the call.
            let set =
                unsafe { nix::libc::syscall(nix::libc::SYS_setgroups, gids.len(), gids.as_ptr()) };
            Errno::result(set).unwrap();
            assert_eq!(groups_of_a_pair(), gids);
        });
        told.join().unwrap();
    }
}

#[test]
fn a_full_backlog_would_block() {
    let directory = tempfile::tempdir().unwrap();
    let path = directory.path().join("s");
    let listener = Listener::bind(&path, 2).unwrap();
    let mut waiting = Vec::new();
    let error = loop {
        match SeqPacket::connect(&path) {
            Ok(socket) => waiting.push(socket),
            Err(error) => break error,
        }
        assert!(waiting.len() < 100, "the backlog has no end");
    };
    assert_eq!(error.kind(), io::ErrorKind::WouldBlock);
    assert!(listener.accept().unwrap().is_some());
    SeqPacket::connect(&path).unwrap();
}

#[test]
fn paths_that_no_address_can_hold_are_refused() {
    let long = format!("/tmp/{}", "x".repeat(108));
    for path in ["", long.as_str(), "/tmp/a\0b"] {
        let connect = SeqPacket::connect(path.as_ref()).unwrap_err();
        let bind = Listener::bind(path.as_ref(), 1).unwrap_err();
        assert_eq!(connect.kind(), io::ErrorKind::InvalidInput, "{path:?}");
        assert_eq!(bind.kind(), io::ErrorKind::InvalidInput, "{path:?}");
    }
}
