//! No received datagram leaves a descriptor open. One test, alone in its process: it counts the open
//! descriptors and lowers limits.

// Shows DAT-NOLEAK (test), bound: one process.

use sm2_test_support::ran_alone;
use std::io::IoSlice;
use std::os::fd::{AsFd, AsRawFd, BorrowedFd};

use nix::libc;
use nix::sys::resource::{Resource, getrlimit, setrlimit};
use sm2_io::fault::{Call, Fault, Injector};
use sm2_io::{RecvError, SeqPacket, free_descriptors, raise_descriptor_limit};

fn open() -> usize {
    std::fs::read_dir("/proc/self/fd").unwrap().count()
}

fn send_many(socket: &SeqPacket, bytes: &[u8], fd: BorrowedFd<'_>, count: usize) {
    socket
        .send(&[IoSlice::new(bytes)], &vec![fd; count])
        .unwrap();
}

#[test]
fn every_received_descriptor_is_closed() {
    if ran_alone(concat!(
        module_path!(),
        "::every_received_descriptor_is_closed"
    )) {
        return;
    }
    let before = open();
    {
        let file = tempfile::tempfile().unwrap();
        let (a, b) = SeqPacket::pair().unwrap();
        let base = open();

        received_and_dropped(&a, &b, file.as_fd());
        assert_eq!(open(), base, "dropped");
        truncated_data(&a, &b, file.as_fd());
        assert_eq!(open(), base, "truncated data");
        truncated_control(&a, &b, file.as_fd());
        assert_eq!(open(), base, "truncated control");
        an_added_pidfd(&a, &b, file.as_fd());
        assert_eq!(open(), base, "pidfd");
        an_empty_datagram(&a, &b, file.as_fd());
        assert_eq!(open(), base, "empty datagram");
        send_many(&a, b"never received", file.as_fd(), 100);
        assert!(SeqPacket::from_fd(file.try_clone().unwrap().into()).is_err());
        assert_eq!(open(), base, "not adopted");
    }
    assert_eq!(open(), before, "at the end");
}

fn received_and_dropped(a: &SeqPacket, b: &SeqPacket, fd: BorrowedFd<'_>) {
    let base = open();
    for _ in 0..100 {
        send_many(a, b"x", fd, 253);
        let received = b.recv(&mut [0; 8]).unwrap();
        assert_eq!((received.fds.len(), open()), (253, base + 253));
    }
}

fn truncated_data(a: &SeqPacket, b: &SeqPacket, fd: BorrowedFd<'_>) {
    send_many(a, &[1; 100], fd, 4);
    let received = b.recv(&mut [0; 8]).unwrap();
    assert!(received.data_truncated && !received.control_truncated);
    assert_eq!(received.fds.len(), 4);
}

/// This process has room for only some of the descriptors.
fn truncated_control(a: &SeqPacket, b: &SeqPacket, fd: BorrowedFd<'_>) {
    send_many(a, b"x", fd, 8);
    let (soft, hard) = getrlimit(Resource::RLIMIT_NOFILE).unwrap();
    // Reserves the lowest free numbers, which the kernel would use.
    let free: Vec<_> = (0..3).map(|_| fd.try_clone_to_owned().unwrap()).collect();
    let limit = free.iter().map(|fd| fd.as_raw_fd()).max().unwrap() + 1;
    drop(free);
    setrlimit(Resource::RLIMIT_NOFILE, u64::try_from(limit).unwrap(), hard).unwrap();
    let received = b.recv(&mut [0; 8]);
    setrlimit(Resource::RLIMIT_NOFILE, soft, hard).unwrap();
    let received = received.unwrap();
    assert!(received.control_truncated && !received.data_truncated);
    assert_eq!(received.fds.len(), 3);
}

/// The process that created the socket asked the kernel to add a pidfd to each datagram.
fn an_added_pidfd(a: &SeqPacket, b: &SeqPacket, fd: BorrowedFd<'_>) {
    const SO_PASSPIDFD: libc::c_int = 76;
    let set = |on: libc::c_int| {
        let (at, len) = ((&raw const on).cast(), size_of_val(&on) as libc::socklen_t);
        let number = b.as_fd().as_raw_fd();
        // SAFETY: the option's value is an int that outlives the call.
        unsafe { libc::setsockopt(number, libc::SOL_SOCKET, SO_PASSPIDFD, at, len) }
    };
    if set(1) != 0 {
        return; // Before Linux 6.5 there is no such option.
    }
    for count in [0, 1, 253] {
        send_many(a, b"x", fd, count);
        let received = b.recv(&mut [0; 8]).unwrap();
        assert!(!received.control_truncated);
        assert_eq!(received.fds.len(), count);
    }
    assert_eq!(set(0), 0);
}

fn an_empty_datagram(a: &SeqPacket, b: &SeqPacket, fd: BorrowedFd<'_>) {
    use nix::sys::socket::{ControlMessage, MsgFlags, sendmsg};
    let fds = [fd.as_raw_fd(); 3];
    let rights = [ControlMessage::ScmRights(&fds)];
    // QEMU does not send a datagram that has no part at all.
    let parts = [IoSlice::new(&[])];
    let flags = MsgFlags::empty();
    sendmsg::<()>(a.as_fd().as_raw_fd(), &parts, &rights, flags, None).unwrap();
    assert!(matches!(b.recv(&mut [0; 8]), Err(RecvError::Closed)));
}

/// An older kernel does not count the open ones, so this process looks at each number.
#[test]
fn free_descriptors_are_those_below_the_limit() {
    if ran_alone(concat!(
        module_path!(),
        "::free_descriptors_are_those_below_the_limit"
    )) {
        return;
    }
    // Above all numbers that the program got from its parent.
    const LIMIT: usize = 512;
    let (_, hard) = getrlimit(Resource::RLIMIT_NOFILE).unwrap();
    setrlimit(Resource::RLIMIT_NOFILE, LIMIT as u64, hard).unwrap();
    let older = Fault {
        call: Call::Stat,
        nth: 1,
        times: u64::MAX,
        errno: libc::ENOENT,
    };
    let mut opened = Vec::new();
    for _ in 0..10 {
        opened.push(tempfile::tempfile().unwrap());
        // Counting opens one more.
        let free = LIMIT - (open() - 1);
        for fault in [None, Some(older)] {
            let faults = Injector::counting();
            faults.set(fault);
            let _installed = faults.install();
            assert_eq!(free_descriptors(usize::MAX).unwrap(), free, "{fault:?}");
            assert_eq!(free_descriptors(3).unwrap(), 3, "{fault:?}");
        }
    }
    raise_descriptor_limit();
    let raised = getrlimit(Resource::RLIMIT_NOFILE).unwrap();
    assert_eq!(raised, (hard, hard));
}
