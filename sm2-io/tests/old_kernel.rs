//! A kernel without the newest system calls and flags. A seccomp filter simulates an older kernel for the
//! calling thread.

use std::os::fd::AsFd;
use std::time::Duration;

use nix::errno::Errno;
use nix::libc;
use nix::sys::memfd::{MFdFlags, memfd_create};
use sm2_io::clock::now;
use sm2_io::memfd::{facts, sealed_from_bytes};
use sm2_io::{Epoll, Events, Interest, Waker};
use sm2_proto::Seals;

const NUMBER: u32 = 0;
/// Offset of the lower half of the second argument.
const FLAGS: u32 = 24;

/// Makes `epoll_pwait2` and `MFD_NOEXEC_SEAL` fail in the calling thread.
fn become_older() {
    let load = |offset| libc::sock_filter {
        code: (libc::BPF_LD | libc::BPF_W | libc::BPF_ABS) as u16,
        jt: 0,
        jf: 0,
        k: offset,
    };
    let jump = |test, value, jt, jf| libc::sock_filter {
        code: (libc::BPF_JMP | test | libc::BPF_K) as u16,
        jt,
        jf,
        k: value,
    };
    let answer = |value| libc::sock_filter {
        code: (libc::BPF_RET | libc::BPF_K) as u16,
        jt: 0,
        jf: 0,
        k: value,
    };
    let error = |errno| libc::SECCOMP_RET_ERRNO | u32::try_from(errno).unwrap();
    let number = |number| u32::try_from(number).unwrap();
    let mut filter = [
        load(NUMBER),
        jump(libc::BPF_JEQ, number(libc::SYS_epoll_pwait2), 4, 0),
        jump(libc::BPF_JEQ, number(libc::SYS_memfd_create), 0, 4),
        load(FLAGS),
        jump(libc::BPF_JSET, libc::MFD_NOEXEC_SEAL, 0, 2),
        answer(error(libc::EINVAL)),
        answer(error(libc::ENOSYS)),
        answer(libc::SECCOMP_RET_ALLOW),
    ];
    let program = libc::sock_fprog {
        len: u16::try_from(filter.len()).unwrap(),
        filter: filter.as_mut_ptr(),
    };
    // SAFETY: the program and its filter outlive the calls, which copy them.
    let results = unsafe {
        [
            libc::prctl(libc::PR_SET_NO_NEW_PRIVS, 1, 0, 0, 0),
            libc::prctl(
                libc::PR_SET_SECCOMP,
                libc::SECCOMP_MODE_FILTER,
                &raw const program,
            ),
        ]
    };
    assert_eq!(results, [0, 0], "{}", Errno::last());
}

#[test]
fn waits_in_whole_milliseconds_rounded_up() {
    become_older();
    // SAFETY: the filter answers before the kernel reads any argument.
    let direct = unsafe { libc::syscall(libc::SYS_epoll_pwait2, -1, 0, 0, 0, 0, 0) };
    assert_eq!((direct, Errno::last()), (-1, Errno::ENOSYS));

    let waker = Waker::new().unwrap();
    let epoll = Epoll::new().unwrap();
    epoll.add(&waker, 5, Interest::READABLE).unwrap();
    let mut events = Events::with_capacity(2);
    for micros in [1, 300, 1500] {
        let (start, timeout) = (now(), Duration::from_micros(micros));
        epoll.wait(&mut events, Some(timeout)).unwrap();
        assert!(now().since(start) >= timeout && events.is_empty());
    }
    waker.wake();
    for timeout in [None, Some(Duration::ZERO), Some(Duration::MAX)] {
        epoll.wait(&mut events, timeout).unwrap();
        assert_eq!(events.iter().next().unwrap().token, 5);
    }
}

#[test]
fn seals_without_the_one_against_execution() {
    become_older();
    let flag = MFdFlags::from_bits_retain(libc::MFD_NOEXEC_SEAL);
    assert_eq!(memfd_create(c"test", flag).unwrap_err(), Errno::EINVAL);

    let facts = facts(sealed_from_bytes(b"bytes").unwrap().as_fd()).unwrap();
    assert_eq!((facts.seals, facts.size_bytes), (Seals::SEALED, 5));
}
