//! Memory that is made present before it is used, in huge pages if the machine has them. The assertions hold
//! with and without huge pages.

use std::fs::File;
use std::os::fd::{AsFd, AsRawFd, BorrowedFd};
use std::os::unix::fs::MetadataExt;

use crate::common::{map_pooled, map_sealed};
use sm2_io::memfd::{facts, sealed_from_bytes};
use sm2_io::{Preallocated, SealedLoan, Segment};
use sm2_proto::Seals;
use sm2_test_support::{skip, until};

const HUGE: usize = 2 << 20;

/// Returns the memory that a file occupies, in bytes.
fn present(fd: BorrowedFd<'_>) -> usize {
    let file = File::open(format!("/proc/self/fd/{}", fd.as_raw_fd())).unwrap();
    usize::try_from(file.metadata().unwrap().blocks()).unwrap() * 512
}

fn pattern(len: usize) -> Vec<u8> {
    (0..len).map(|at| (at % 251) as u8 + 1).collect()
}

/// Checks that the file contains these bytes, followed by zeroes only.
fn assert_message(fd: BorrowedFd<'_>, bytes: &[u8]) {
    let known = facts(fd).unwrap();
    assert!(
        known.regular && known.seals.contains(Seals::SEALED),
        "{known:?}"
    );
    assert!(known.size_bytes >= bytes.len() as u64);
    let all = map_sealed(fd, known.size_bytes, true);
    let (message, rest) = all.as_slice().split_at(bytes.len());
    assert!(message == bytes, "a message of {}", bytes.len());
    assert!(
        rest.iter().all(|&byte| byte == 0),
        "the bytes behind the message are zero"
    );
}

#[test]
fn preallocated_files_hold_all_that_fits() {
    for capacity in [
        0,
        1,
        4096,
        100_000,
        HUGE / 4,
        HUGE - 1,
        HUGE + 1,
        3 * HUGE + 5,
    ] {
        for len in [0, 1, capacity / 4, capacity - capacity.min(1), capacity] {
            let bytes = pattern(len.min(capacity));
            let preallocated = Preallocated::for_copies(capacity).unwrap();
            assert_eq!(preallocated.capacity_bytes(), capacity);
            assert_message(preallocated.fill(&bytes).unwrap().as_fd(), &bytes);
            for made in [Preallocated::for_loans, Preallocated::for_copies] {
                let mut loan = made(capacity).unwrap().lend(bytes.len()).unwrap();
                assert_eq!(loan.len(), bytes.len());
                assert!(loan.as_slice().iter().all(|&byte| byte == 0));
                loan.as_mut_slice().copy_from_slice(&bytes);
                assert_message(loan.seal().unwrap().as_fd(), &bytes);
            }
        }
    }
}

#[test]
#[should_panic(expected = "2 bytes in a preallocated file of 1")]
fn a_preallocated_file_that_is_too_small() {
    let _ = Preallocated::for_copies(1).unwrap().fill(b"ab");
}

#[test]
fn what_a_message_does_not_need_is_given_back() {
    for capacity in [1 << 18, 4 * HUGE] {
        let fd = Preallocated::for_copies(capacity)
            .unwrap()
            .fill(&[1; 5000])
            .unwrap();
        assert!(
            present(fd.as_fd()) <= capacity / 4,
            "{}",
            present(fd.as_fd())
        );
    }
}

#[test]
fn a_copy_is_as_long_as_its_bytes() {
    for len in [HUGE / 4, HUGE / 4 - 1, HUGE + 1, 10_000_000] {
        let bytes = pattern(len);
        let fd = sealed_from_bytes(&bytes).unwrap();
        assert_eq!(facts(fd.as_fd()).unwrap().size_bytes, len as u64);
        assert_message(fd.as_fd(), &bytes);
        let mut loan = SealedLoan::new(len as u64).unwrap();
        loan.as_mut_slice().copy_from_slice(&bytes);
        let fd = loan.seal().unwrap();
        assert_eq!(facts(fd.as_fd()).unwrap().size_bytes, len as u64);
        assert_message(fd.as_fd(), &bytes);
    }
}

#[test]
fn a_prefaulted_segment_is_all_there() {
    for (stride, slots) in [(4096, 3), (HUGE, 3), (HUGE + 4096, 2), (6 * HUGE, 2)] {
        let mut segment = Segment::create(stride as u64, slots).unwrap();
        assert_eq!(
            present(segment.fd()),
            0,
            "no page is present before prefault"
        );
        segment.prefault().unwrap();
        assert!(present(segment.fd()) >= stride * slots as usize);
        let (fd, mut all) = segment.split();
        for slot in &mut all {
            assert!(slot.bytes(stride).iter().all(|&byte| byte == 0));
            slot.bytes_mut(stride).fill(7);
        }
        assert!(present(fd.as_fd()) < stride * slots as usize + HUGE);
    }
}

#[test]
fn warming_a_slot_changes_no_byte_of_any() {
    let (fd, mut slots) = Segment::create(2 * HUGE as u64, 3).unwrap().split();
    let marks = [0, 4095, 4096, HUGE, 2 * HUGE - 1];
    for slot in &mut slots {
        for at in marks {
            slot.bytes_mut(2 * HUGE)[at] = 5;
        }
    }
    let reader = map_pooled(&fd, 6 * HUGE as u64);
    for len in [1, HUGE, HUGE + HUGE / 2, 2 * HUGE, usize::MAX / 4] {
        slots[1].warm(len);
    }
    for (index, slot) in slots.iter().enumerate() {
        let bytes = slot.bytes(2 * HUGE);
        assert!(
            bytes
                == reader
                    .copy_to_vec((index * 2 * HUGE) as u64, 2 * HUGE as u64)
                    .unwrap()
        );
        for (at, &byte) in bytes.iter().enumerate() {
            assert_eq!(byte == 5, marks.contains(&at), "{at} of slot {index}");
        }
    }
    assert!(present(fd.as_fd()) <= 6 * HUGE);
}

#[test]
fn warming_takes_no_memory_for_other_slots() {
    let (fd, mut slots) = Segment::create(2 * HUGE as u64, 3).unwrap().split();
    slots[1].warm(HUGE + 4096);
    assert!(
        present(fd.as_fd()) <= HUGE,
        "the second page has one small page to hold"
    );
    slots[1].warm(2 * HUGE);
    assert!(present(fd.as_fd()) <= 2 * HUGE);
    let (fd, mut slots) = Segment::create(HUGE as u64 + 4096, 3).unwrap().split();
    slots[1].warm(HUGE);
    assert_eq!(present(fd.as_fd()), 0, "slots share huge pages here");
}

/// Holes would give back parts of a segment, but the seals forbid them: only whole segments are freed.
#[test]
fn a_segment_cannot_have_holes() {
    use nix::fcntl::{FallocateFlags, fallocate};
    let mut segment = Segment::create(4096, 4).unwrap();
    segment.prefault().unwrap();
    let hole = FallocateFlags::FALLOC_FL_PUNCH_HOLE | FallocateFlags::FALLOC_FL_KEEP_SIZE;
    let refused = fallocate(segment.fd(), hole, 0, 4096);
    assert_eq!(refused, Err(nix::errno::Errno::EPERM));
}

/// Returns how many bytes of the mapping that contains this address are in huge pages.
fn in_huge_pages(address: *const u8) -> usize {
    let maps = std::fs::read_to_string("/proc/self/smaps").unwrap();
    let mut inside = false;
    for line in maps.lines() {
        let (first, rest) = line.split_once(' ').unwrap_or((line, ""));
        if let Some((start, end)) = first.split_once('-')
            && let Ok(start) = usize::from_str_radix(start, 16)
            && let Ok(end) = usize::from_str_radix(end, 16)
        {
            inside = (start..end).contains(&address.addr());
        } else if inside && first == "ShmemPmdMapped:" {
            let kibibytes = rest.trim().trim_end_matches(" kB");
            return kibibytes.parse::<usize>().unwrap() * 1024;
        }
    }
    panic!("no mapping at {address:?}");
}

/// For sealed and for pooled memory, readers map the author's huge pages as huge pages.
#[test]
fn readers_map_huge_pages_as_one() {
    // The kernel may split or make a huge page between two looks.
    let (mut has_pages, mut counts) = (false, (0, 0));
    until("readers have the huge pages of authors", || {
        has_pages = kernel_has_pages();
        counts = as_one();
        let is_huge = counts.0 > 0 && counts.1 > 0;
        counts != (usize::MAX, usize::MAX) && (is_huge || !has_pages)
    });
    if !has_pages {
        let (pooled, sealed) = counts;
        skip(format_args!(
            "no huge page is free: {pooled} bytes of a slot, {sealed} bytes of a message"
        ));
    }
}

/// Whether the kernel moves as much memory of a file into huge pages as [`as_one`] asks for.
fn kernel_has_pages() -> bool {
    use nix::libc;
    use nix::sys::memfd::{MFdFlags, memfd_create};
    use nix::sys::mman::{MapFlags, ProtFlags, mmap, mmap_anonymous, munmap};
    use std::num::NonZeroUsize;
    const MADV_COLLAPSE: libc::c_int = 25;
    const LEN: NonZeroUsize = NonZeroUsize::new(5 * HUGE).unwrap();
    const ROOM: NonZeroUsize = NonZeroUsize::new(6 * HUGE).unwrap();
    let file = File::from(memfd_create("pages", MFdFlags::MFD_CLOEXEC).unwrap());
    file.set_len(LEN.get() as u64).unwrap();
    let prot = ProtFlags::PROT_READ | ProtFlags::PROT_WRITE;
    // SAFETY: the kernel chooses a range that overlaps no mapping. The file is mapped inside of this range, at a
    // multiple of the size of a huge page. Nothing refers to the range when it is unmapped.
    unsafe {
        let room = mmap_anonymous(None, ROOM, ProtFlags::PROT_NONE, MapFlags::MAP_PRIVATE).unwrap();
        let place = NonZeroUsize::new(room.addr().get().next_multiple_of(HUGE));
        let flags = MapFlags::MAP_SHARED | MapFlags::MAP_FIXED;
        let start = mmap(place, LEN, prot, flags, &file, 0).unwrap();
        std::ptr::write_bytes(start.as_ptr().cast::<u8>(), 7, LEN.get());
        let result = libc::madvise(start.as_ptr(), LEN.get(), MADV_COLLAPSE);
        munmap(room, ROOM.get()).unwrap();
        result == 0
    }
}

/// How many bytes of a slot, and of a sealed message, are in huge pages, both for their author and for a reader;
/// `usize::MAX` twice if author and reader differ.
fn as_one() -> (usize, usize) {
    let (fd, mut slots) = Segment::create(6 * HUGE as u64, 2).unwrap().split();
    slots[1].warm(10_000_000);
    slots[1].bytes_mut(10_000_000).fill(7);
    let reader = map_pooled(&fd, 12 * HUGE as u64);
    let bytes = reader.range(6 * HUGE as u64, 10_000_000).unwrap();
    // SAFETY: the range is inside the mapping, and the slot is not written from here on.
    assert!(unsafe { bytes.as_ref() }.iter().all(|&byte| byte == 7));
    let pooled = in_huge_pages(slots[1].bytes(1).as_ptr());
    if in_huge_pages(bytes.as_ptr().cast()) != pooled {
        return (usize::MAX, usize::MAX);
    }

    let mut loan = SealedLoan::new(10_000_000).unwrap();
    loan.as_mut_slice().fill(7);
    let sealed = in_huge_pages(loan.as_slice().as_ptr());
    let fd = loan.seal().unwrap();
    let reader = map_sealed(&fd, 10_000_000, true);
    if in_huge_pages(reader.as_ptr()) != sealed {
        return (usize::MAX, usize::MAX);
    }
    (pooled, sealed)
}
