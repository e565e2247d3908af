//! A kernel without huge pages, and without calls that make pages present (before Linux 5.14). A seccomp
//! filter simulates that kernel for the calling thread.

use crate::common;
use std::os::fd::AsFd;

use nix::libc;
use sm2_io::memfd::{facts, sealed_from_bytes};
use sm2_io::{Preallocated, SealedLoan, Segment};
use sm2_proto::Seals;

const NUMBER: u32 = 0;
/// Offset of the lower half of the third argument.
const ADVICE: u32 = 32;

/// Makes `MADV_COLLAPSE` and `MADV_POPULATE_WRITE` fail in the calling thread.
fn become_older() {
    let load = |offset| libc::sock_filter {
        code: (libc::BPF_LD | libc::BPF_W | libc::BPF_ABS) as u16,
        jt: 0,
        jf: 0,
        k: offset,
    };
    let jump = |value, jt, jf| libc::sock_filter {
        code: (libc::BPF_JMP | libc::BPF_JEQ | libc::BPF_K) as u16,
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
    let unknown = libc::SECCOMP_RET_ERRNO | u32::try_from(libc::EINVAL).unwrap();
    let mut filter = [
        load(NUMBER),
        jump(u32::try_from(libc::SYS_madvise).unwrap(), 0, 3),
        load(ADVICE),
        jump(25, 2, 0),
        jump(23, 1, 0),
        answer(libc::SECCOMP_RET_ALLOW),
        answer(unknown),
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
    assert_eq!(results, [0, 0]);
}

#[test]
fn everything_works_with_small_pages() {
    become_older();
    for len in [600_000, 2 << 20, 10_000_000] {
        let bytes: Vec<u8> = (0..len).map(|at| (at % 251) as u8).collect();
        let mut loan = SealedLoan::new(len as u64).unwrap();
        loan.as_mut_slice().copy_from_slice(&bytes);
        let mut lent = Preallocated::for_loans(len + 5_000)
            .unwrap()
            .lend(len)
            .unwrap();
        lent.as_mut_slice().copy_from_slice(&bytes);
        let messages = [
            sealed_from_bytes(&bytes).unwrap(),
            loan.seal().unwrap(),
            Preallocated::for_copies(len).unwrap().fill(&bytes).unwrap(),
            lent.seal().unwrap(),
        ];
        for fd in messages {
            let known = facts(fd.as_fd()).unwrap();
            assert!(known.seals.contains(Seals::SEALED), "{known:?}");
            assert_eq!(known.size_bytes, len as u64);
            let seen = common::map_sealed(&fd, len as u64, true);
            assert!(seen.as_slice() == bytes);
        }
        let mut segment = Segment::create((len as u64).next_multiple_of(2 << 20), 2).unwrap();
        segment.prefault().unwrap();
        let (_fd, mut slots) = segment.split();
        let (_fd, cold) = Segment::create(4 << 20, 1).unwrap().split();
        slots.extend(cold);
        for slot in &mut slots {
            let len = len.min(slot.len_bytes());
            slot.warm(len);
            slot.bytes_mut(len).copy_from_slice(&bytes[..len]);
            assert!(slot.bytes(len) == &bytes[..len]);
        }
    }
}
