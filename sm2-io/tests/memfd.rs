//! Sealed files never change; facts about descriptors.

// Shows DAT-SEALED (test), bound: the kernel of this machine.

use std::fs::{File, OpenOptions};
use std::io::{self, IoSlice};
use std::num::NonZeroUsize;
use std::os::fd::{AsFd, AsRawFd, BorrowedFd, OwnedFd};
use std::os::unix::fs::{FileExt, MetadataExt, OpenOptionsExt};

use crate::common::{map_pooled, map_sealed, pooled_file, sealed_file, until_exited};
use nix::errno::Errno;
use nix::fcntl::{FallocateFlags, fallocate};
use nix::libc;
use nix::sys::memfd::{MFdFlags, memfd_create};
use nix::sys::mman::{MapFlags, ProtFlags, mmap, munmap};
use nix::unistd::ftruncate;
use sm2_io::memfd::{
    InspectedFd, Side, VerifyError, blame, facts, huge_pages_allowed_by, sealed_from_bytes,
    sealed_from_parts,
};
use sm2_io::{PooledMapping, SealedLoan, SealedMapping, Segment};
use sm2_proto::{FdFacts, Seals};

const HUGE: u64 = 2 << 20;
const LENGTHS: [u64; 9] = [0, 1, 8, 4095, 4096, 4097, HUGE - 1, HUGE, HUGE + 1];

/// Returns bytes such that no two pages are equal.
fn pattern(len: u64) -> Vec<u8> {
    (0..len)
        .map(|index| (index * 7 + index / 4096) as u8)
        .collect()
}

fn read(fd: impl AsFd, len: u64) -> Vec<u8> {
    let mut bytes = vec![0; usize::try_from(len).unwrap()];
    let file = File::from(fd.as_fd().try_clone_to_owned().unwrap());
    file.read_exact_at(&mut bytes, 0).unwrap();
    bytes
}

fn map_writable(fd: BorrowedFd<'_>, len: usize) -> Result<(), Errno> {
    let prot = ProtFlags::PROT_READ | ProtFlags::PROT_WRITE;
    let len = NonZeroUsize::new(len).unwrap();
    // SAFETY: the kernel chooses the addresses, and each mapping is unmapped at once.
    unsafe {
        munmap(
            mmap(None, len, prot, MapFlags::MAP_SHARED, fd, 0)?,
            len.get(),
        )
    }
}

/// Checks that a holder of `fd` cannot change a file of `len` bytes in any way.
fn assert_unchangeable(fd: BorrowedFd<'_>, len: u64) {
    let before = read(fd, len);
    let refused = |result: io::Result<()>, how: &str| {
        let error = result.expect_err(how);
        assert_eq!(error.raw_os_error(), Some(libc::EPERM), "{how}");
    };
    let size = i64::try_from(len).unwrap();
    let try_all = |file: &File, name: &str| {
        let how = |what: &str| format!("{what} through {name}");
        refused(file.write_all_at(b"x", 0), &how("write"));
        refused(file.write_all_at(b"x", len), &how("append"));
        refused(
            ftruncate(file, size - 1).map_err(Into::into),
            &how("shrink"),
        );
        refused(ftruncate(file, size + 1).map_err(Into::into), &how("grow"));
        let punch = FallocateFlags::FALLOC_FL_PUNCH_HOLE | FallocateFlags::FALLOC_FL_KEEP_SIZE;
        refused(
            fallocate(file, punch, 0, size).map_err(Into::into),
            &how("punch"),
        );
        let length = usize::try_from(len).unwrap();
        refused(
            map_writable(file.as_fd(), length).map_err(Into::into),
            &how("map"),
        );
        let more = nix::fcntl::FcntlArg::F_ADD_SEALS(nix::fcntl::SealFlag::F_SEAL_WRITE);
        refused(
            nix::fcntl::fcntl(file, more).map(drop).map_err(Into::into),
            &how("seal"),
        );
    };
    try_all(
        &File::from(fd.try_clone_to_owned().unwrap()),
        "the descriptor",
    );
    let name = format!("/proc/self/fd/{}", fd.as_raw_fd());
    match OpenOptions::new().read(true).write(true).open(&name) {
        Ok(file) => try_all(&file, "a new descriptor"),
        Err(error) => assert_eq!(error.raw_os_error(), Some(libc::EPERM)),
    }
    assert_eq!(read(fd, len), before);
}

fn assert_sealed(fd: &OwnedFd, bytes: &[u8]) {
    let len = bytes.len() as u64;
    let facts = facts(fd.as_fd()).unwrap();
    assert!(facts.regular && facts.seals.contains(Seals::SEALED));
    assert_eq!(facts.size_bytes, len);
    assert!(read(fd, len) == bytes, "the bytes of a message of {len}");
}

#[test]
fn copied_messages_of_every_length() {
    for len in LENGTHS {
        let bytes = pattern(len);
        assert_sealed(&sealed_from_bytes(&bytes).unwrap(), &bytes);
        let (head, tail) = bytes.split_at(bytes.len() / 3);
        let parts = [head, b"", tail].map(IoSlice::new);
        assert_sealed(&sealed_from_parts(&parts).unwrap(), &bytes);
    }
    assert_sealed(&sealed_from_parts(&[]).unwrap(), b"");
}

#[test]
fn loans_of_every_length() {
    for len in LENGTHS {
        let bytes = pattern(len);
        let mut loan = SealedLoan::new(len).unwrap();
        assert_eq!((loan.len() as u64, loan.is_empty()), (len, len == 0));
        assert!(loan.as_slice().iter().all(|byte| *byte == 0));
        loan.as_mut_slice().copy_from_slice(&bytes);
        assert!(loan.as_slice() == bytes);
        assert_sealed(&loan.seal().unwrap(), &bytes);
    }
    drop(SealedLoan::new(HUGE).unwrap());
}

#[test]
fn impossible_lengths_are_errors() {
    for len in [u64::MAX, 1 << 63, i64::MAX as u64] {
        assert!(SealedLoan::new(len).is_err(), "{len}");
        assert!(Segment::create(len, 1).is_err(), "{len}");
        let fd = sealed_from_bytes(b"x").unwrap();
        let sealed = sealed_file(&fd);
        assert!(SealedMapping::new(&sealed, len, false).is_err(), "{len}");
    }
    assert!(Segment::create(1 << 62, 16).is_err());
}

#[test]
fn nobody_can_change_a_sealed_message() {
    for len in [1, 4096, HUGE + 1] {
        let bytes = pattern(len);
        assert_unchangeable(sealed_from_bytes(&bytes).unwrap().as_fd(), len);
        let mut loan = SealedLoan::new(len).unwrap();
        loan.as_mut_slice().copy_from_slice(&bytes);
        assert_unchangeable(loan.seal().unwrap().as_fd(), len);
    }
}

#[test]
fn nobody_but_the_author_can_change_a_segment() {
    for stride in [64, 4096, HUGE] {
        let segment = Segment::create(stride, 3).unwrap();
        let len = 3 * stride;
        let known = facts(segment.fd()).unwrap();
        assert!(known.regular && known.seals.contains(Seals::POOLED));
        assert!(!known.seals.contains(Seals::WRITE));
        assert_eq!(known.size_bytes, len);
        assert_unchangeable(segment.fd(), len);

        let reader = PooledMapping::new(&pooled_file(segment.fd()), len, true).unwrap();
        let bytes = pattern(stride);
        for slot in 0..3 {
            // SAFETY: no other reference to a slot exists; the reader makes copies.
            unsafe { segment.slot_mut(slot, bytes.len()) }.copy_from_slice(&bytes);
            assert!(
                reader
                    .copy_to_vec(u64::from(slot) * stride, stride)
                    .unwrap()
                    == bytes
            );
            // SAFETY: the mutable slice is gone.
            assert!(unsafe { segment.slot(slot, bytes.len()) } == bytes);
        }
        drop(segment);
        assert!(
            reader.copy_to_vec(2 * stride, stride).unwrap() == bytes,
            "outlives its author"
        );
    }
}

#[test]
fn segments_may_be_empty() {
    for (stride, slots) in [(0, 0), (0, 5), (64, 0)] {
        let segment = Segment::create(stride, slots).unwrap();
        assert_eq!((segment.slots(), segment.len_bytes()), (slots, 0));
        assert_eq!(segment.stride_bytes() as u64, stride);
        assert_eq!(facts(segment.fd()).unwrap().size_bytes, 0);
        for slot in 0..slots {
            // SAFETY: the slice is empty.
            assert!(unsafe { segment.slot_mut(slot, 0) }.is_empty());
        }
    }
}

#[test]
#[should_panic(expected = "slot 2 of a segment with 2 slots")]
fn a_slot_that_does_not_exist() {
    let _ = Segment::create(64, 2).unwrap().slot_ptr(2);
}

#[test]
#[should_panic(expected = "65 bytes of a slot of 64 bytes")]
fn a_slot_that_is_too_small() {
    let segment = Segment::create(64, 2).unwrap();
    // SAFETY: panics before it creates a reference.
    let _ = unsafe { segment.slot(0, 65) };
}

#[test]
fn mappings_hand_out_what_is_inside() {
    let fd = sealed_from_bytes(b"0123456789").unwrap();
    for populate in [false, true] {
        assert_eq!(*map_sealed(&fd, 10, populate), *b"0123456789");
        assert_eq!(*map_sealed(&fd, 3, populate), *b"012");
        assert!(map_sealed(&fd, 0, populate).is_empty());
    }
    let segment = Segment::create(16, 1).unwrap();
    // SAFETY: no other reference to the slot exists.
    unsafe { segment.slot_mut(0, 10) }.copy_from_slice(b"0123456789");
    let mapping = map_pooled(segment.fd(), 10);
    assert_eq!((mapping.len(), mapping.is_empty()), (10, false));
    assert_eq!(mapping.copy_to_vec(0, 10).unwrap(), b"0123456789");
    assert_eq!(mapping.copy_to_vec(3, 2).unwrap(), b"34");
    assert_eq!(mapping.copy_to_vec(10, 0).unwrap(), b"");
    assert_eq!(mapping.copy::<8>(0).unwrap(), *b"01234567");
    assert!(mapping.copy::<8>(8).is_none() && mapping.copy::<8>(1).is_none());
    assert!(mapping.copy::<9>(0).is_none());
    for (start, len) in [(0, 11), (10, 1), (11, 0), (u64::MAX, 2), (2, u64::MAX)] {
        assert!(mapping.range(start, len).is_none(), "{len} from {start}");
        assert!(mapping.copy_to_vec(start, len).is_none());
    }
    assert!(map_pooled(segment.fd(), 0).is_empty());
}

//= SM2-SEG-001 test
#[test]
fn a_file_that_is_open_for_writing_alone_proves_nothing() {
    let fd = sealed_from_bytes(b"0123456789").unwrap();
    let write_only = OpenOptions::new()
        .write(true)
        .open(format!("/proc/self/fd/{}", fd.as_raw_fd()))
        .unwrap();
    let known = facts(write_only.as_fd()).unwrap();
    assert!(!known.regular && known.seals.contains(Seals::SEALED));
    let inspected = InspectedFd::new(write_only.into()).unwrap();
    assert_eq!(inspected.into_sealed().unwrap_err(), VerifyError::NotAMemfd);
}

#[test]
fn each_error_of_a_received_descriptor_is_one_sides() {
    let of = |errno| blame(&io::Error::from_raw_os_error(errno));
    for errno in [
        libc::EMFILE,
        libc::ENFILE,
        libc::ENOMEM,
        libc::ENOBUFS,
        libc::ENOSPC,
        libc::EAGAIN,
        libc::EINTR,
    ] {
        assert_eq!(of(errno), Side::Receiver, "{errno}");
    }
    for errno in [
        libc::EACCES,
        libc::EPERM,
        libc::EBADF,
        libc::EINVAL,
        libc::ENODEV,
        libc::EOVERFLOW,
        libc::EIO,
    ] {
        assert_eq!(of(errno), Side::Sender, "{errno}");
    }
    let proof = io::Error::other(VerifyError::NotAMemfd);
    assert_eq!(blame(&proof), Side::Sender);
}

#[test]
fn facts_about_what_is_not_a_message() {
    let nothing = FdFacts::default();
    let directory = tempfile::tempdir().unwrap();
    let path = directory.path().join("file");
    std::fs::write(&path, "bytes").unwrap();
    let path_only = OpenOptions::new()
        .read(true)
        .custom_flags(libc::O_PATH)
        .open(&path);
    let fds: [(&str, OwnedFd); 7] = [
        ("pipe", nix::unistd::pipe().unwrap().0),
        ("directory", File::open(directory.path()).unwrap().into()),
        ("device", File::open("/dev/zero").unwrap().into()),
        ("path only", path_only.unwrap().into()),
        ("socket", sm2_io::SeqPacket::pair().unwrap().0.into()),
        (
            "epoll",
            sm2_io::Epoll::new()
                .unwrap()
                .as_fd()
                .try_clone_to_owned()
                .unwrap(),
        ),
        (
            "eventfd",
            sm2_io::Waker::new()
                .unwrap()
                .as_fd()
                .try_clone_to_owned()
                .unwrap(),
        ),
    ];
    for (what, fd) in fds {
        assert_eq!(facts(fd.as_fd()).unwrap(), nothing, "{what}");
    }

    // Some temporary directories are in memory, so the kernel may give facts about this file; its seals prove
    // nothing.
    let on_disk = facts(File::open(&path).unwrap().as_fd()).unwrap();
    assert!(!on_disk.seals.contains(Seals::SHRINK));

    if let Ok(file) = tempfile::tempfile_in("/dev/shm") {
        file.set_len(9).unwrap();
        let known = facts(file.as_fd()).unwrap();
        assert_eq!(
            known.seals,
            Seals::SEAL,
            "answers, although it is not a memfd"
        );
        assert_eq!((known.regular, known.size_bytes), (true, 9));
    }
}

#[test]
fn facts_about_memfds() {
    let unsealed = File::from(memfd_create(c"test", MFdFlags::MFD_ALLOW_SEALING).unwrap());
    unsealed.set_len(5000).unwrap();
    let known = facts(unsealed.as_fd()).unwrap();
    assert_eq!(
        (known.regular, known.size_bytes, known.seals),
        (true, 5000, Seals(0))
    );

    let not_sealable = memfd_create(c"test", MFdFlags::empty()).unwrap();
    assert_eq!(facts(not_sealable.as_fd()).unwrap().seals, Seals::SEAL);

    // Mappings of such a file cannot be unmapped by the message's length.
    let flags = MFdFlags::MFD_HUGETLB | MFdFlags::MFD_ALLOW_SEALING;
    if let Ok(huge) = memfd_create(c"test", flags) {
        assert!(!facts(huge.as_fd()).unwrap().regular);
    }
}

#[test]
fn a_message_is_not_a_program() {
    const F_SEAL_EXEC: u32 = 0x20;
    let fd = sealed_from_bytes(b"x").unwrap();
    let fixed = facts(fd.as_fd())
        .unwrap()
        .seals
        .contains(Seals(F_SEAL_EXEC));
    let executable = File::from(fd).metadata().unwrap().mode() & 0o111 != 0;
    // Kernels before 6.3 do not know this seal and make every memfd executable.
    assert_eq!(fixed, !executable);
}

/// A child process inherits mappings, and the kernel refuses to seal while a writable one exists.
#[test]
fn a_child_process_does_not_keep_a_loan_from_being_sealed() {
    let (wait, end) = nix::unistd::pipe().unwrap();
    let mut loan = SealedLoan::new(100).unwrap();
    loan.as_mut_slice().fill(1);
    // SAFETY: the child makes two system calls and exits; it accesses no other memory.
    let child = match unsafe { nix::unistd::fork() }.unwrap() {
        nix::unistd::ForkResult::Child => {
            // SAFETY: the child closes the inherited end, so that `read` returns when the parent is done.
            unsafe {
                libc::close(end.as_raw_fd());
                let mut byte = 0_u8;
                libc::read(wait.as_raw_fd(), (&raw mut byte).cast(), 1);
                libc::_exit(0)
            }
        }
        nix::unistd::ForkResult::Parent { child } => child,
    };
    let sealed = loan.seal();
    drop(end);
    until_exited(child);
    assert_sealed(&sealed.unwrap(), &[1; 100]);
}

#[test]
fn the_setting_for_huge_pages() {
    let with = |chosen: &str| {
        let line = "always within_size advise never deny force\n";
        line.replace(chosen, &format!("[{chosen}]"))
    };
    for chosen in ["always", "within_size", "advise", "force"] {
        assert!(huge_pages_allowed_by(&with(chosen)), "{chosen}");
    }
    for chosen in ["never", "deny", "something new"] {
        assert!(!huge_pages_allowed_by(&with(chosen)), "{chosen}");
    }
    for text in ["", "always", "[", "[]", "[always"] {
        assert!(!huge_pages_allowed_by(text), "{text:?}");
    }
}

#[test]
#[ignore = "takes more than 2 GiB of memory"]
fn a_message_that_one_write_cannot_take() {
    let mut bytes = vec![0; (2 << 30) + 5];
    *bytes.last_mut().unwrap() = 9;
    let fd = sealed_from_bytes(&bytes).unwrap();
    let len = bytes.len() as u64;
    assert_eq!(facts(fd.as_fd()).unwrap().size_bytes, len);
    let mapping = map_sealed(&fd, len, false);
    assert_eq!(mapping.last_chunk(), Some(&[0, 9]));
}
