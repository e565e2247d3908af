//! The file of a ring, which two processes write: its seals, its size, and the offsets of its words.

use std::fs::{File, OpenOptions};
use std::io::{self, Read};
use std::os::fd::{AsFd, AsRawFd, OwnedFd};
use std::os::unix::fs::FileExt;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::process::{Command, Stdio};

use crate::common::ring_file;
use nix::errno::Errno;
use nix::fcntl::{FallocateFlags, FcntlArg, SealFlag, fallocate, fcntl};
use nix::unistd::ftruncate;
use sm2_io::memfd::facts;
use sm2_io::{InspectedFd, Ring, VerifyError};
use sm2_proto::Seals;
use sm2_proto::link::{At, CELL_WORDS, EMPTY, RingLayout, RingMemory};

/// The smallest and the largest layout, and three others.
const LAYOUTS: [(u16, u32); 5] = [(1, 2), (8, 12), (3, 7), (13, 2048), (1024, 2048)];

fn layout(depth: u16, window: u32) -> RingLayout {
    RingLayout::new(depth, window).expect("a legal layout")
}

/// Returns every word of a ring with its offset by SPEC section 8.5.
fn words(depth: u16, window: u32) -> Vec<(At, u64)> {
    let back = 128 + 128 * u64::from(depth);
    let parked = [(At::ReceiverParked, 0), (At::SenderParked, 64)];
    let forward = (0..u32::from(depth)).map(|it| (At::Forward(it), 128 + 128 * u64::from(it)));
    let back = (0..window).map(|it| (At::Back(it), back + 8 * u64::from(it)));
    parked.into_iter().chain(forward).chain(back).collect()
}

/// Returns the size of the file by SPEC section 8.5.
fn size(depth: u16, window: u32) -> u64 {
    let (_, last) = words(depth, window).pop().expect("a word");
    (last + 8).div_ceil(4096) * 4096
}

/// Opens the file again, to access it without the mapping.
fn reopened(fd: &OwnedFd) -> File {
    let path = format!("/proc/self/fd/{}", fd.as_raw_fd());
    OpenOptions::new().read(true).open(path).expect("the file")
}

fn word_at(file: &File, offset: u64) -> u64 {
    let mut bytes = [0; 8];
    file.read_exact_at(&mut bytes, offset).expect("a word");
    u64::from_le_bytes(bytes)
}

//= SM2-RNG-002 test
#[test]
fn a_new_ring_has_just_these_seals_and_just_this_size_and_is_all_zero() {
    for (depth, window) in LAYOUTS {
        let (ring, fd) = Ring::create(layout(depth, window)).expect("a ring");
        let facts = facts(fd.as_fd()).expect("facts");
        assert!(facts.regular);
        // Neither WRITE nor FUTURE_WRITE. From Linux 6.3 on, the file also has the seal EXEC.
        let not_executable = 0x20;
        assert_eq!(
            Seals(facts.seals.0 & !not_executable),
            Seals(0x1 | 0x2 | 0x4)
        );
        assert_eq!(facts.size_bytes, size(depth, window), "{depth} {window}");
        let mut all = Vec::new();
        reopened(&fd).read_to_end(&mut all).expect("the file");
        assert!(all.iter().all(|it| *it == 0));
        drop(ring);
    }
}

//= SM2-RNG-002 test
#[test]
fn each_word_is_where_spec_says() {
    for (depth, window) in LAYOUTS {
        let (ring, fd) = Ring::create(layout(depth, window)).expect("a ring");
        let file = reopened(&fd);
        let words = words(depth, window);
        for (n, (at, _)) in (1..).zip(&words) {
            assert_eq!(ring.swap(*at, n << 32 | n), EMPTY);
        }
        for (n, (at, offset)) in (1..).zip(&words) {
            assert_eq!(word_at(&file, *offset), n << 32 | n, "{at:?}");
        }
        // All other bytes are zero.
        let written = words.len() * 8;
        let mut all = Vec::new();
        reopened(&fd).read_to_end(&mut all).expect("the file");
        let others = all.chunks(8).filter(|it| **it != [0; 8]).count();
        assert_eq!(others * 8, written);
    }
}

/// The words of a cell are those behind its forward word, up to the next forward word or the first back word.
//= SM2-RNG-002, SM2-RNG-013 test
#[test]
fn each_cell_is_behind_its_forward_word() {
    assert_eq!(CELL_WORDS, 15);
    for (depth, window) in LAYOUTS {
        let (ours, fd) = Ring::create(layout(depth, window)).expect("a ring");
        let theirs = Ring::map(&ring_file(&fd), layout(depth, window)).expect("a mapping");
        let file = reopened(&fd);
        let cell = |index: u32| [0; CELL_WORDS].map(|_| u64::from(index) + 1);
        for index in 0..u32::from(depth) {
            ours.write_cell(index, &cell(index));
        }
        for (at, offset) in words(depth, window) {
            assert_eq!(word_at(&file, offset), 0, "{at:?}");
            if let At::Forward(index) = at {
                for n in 1..=CELL_WORDS as u64 {
                    assert_eq!(word_at(&file, offset + 8 * n), u64::from(index) + 1);
                }
                let mut copy = [0; CELL_WORDS];
                theirs.read_cell(index, &mut copy);
                assert_eq!(copy, cell(index));
            }
        }
    }
}

/// A message that is shorter than its cell moves its own words only.
#[test]
fn a_part_of_a_cell_is_its_first_words() {
    let (ring, fd) = Ring::create(layout(3, 7)).expect("a ring");
    ring.write_cell(1, &[1, 2, 3]);
    ring.write_cell(1, &[4, 5]);
    ring.write_cell(1, &[]);
    let mut copy = [9; 4];
    ring.read_cell(1, &mut copy);
    assert_eq!(copy, [4, 5, 3, 0]);
    let mut first = [9; 2];
    ring.read_cell(1, &mut first[..1]);
    assert_eq!(first, [4, 9]);
    // Words are little-endian.
    assert_eq!(word_at(&reopened(&fd), 128 + 128 + 8), 4);
}

/// Each wrong access panics before it touches the memory, as that of a word outside the layout does.
#[test]
fn no_cell_outside_of_the_layout_is_accessed() {
    let (ring, fd) = Ring::create(layout(3, 7)).expect("a ring");
    let refused = |access: &dyn Fn()| {
        catch_unwind(AssertUnwindSafe(access)).expect_err("outside of the layout");
    };
    for index in [3, 4, 0x8000_0000, u32::MAX] {
        refused(&|| ring.write_cell(index, &[1]));
        refused(&|| ring.read_cell(index, &mut [0]));
        refused(&|| ring.write_cell(index, &[]));
        refused(&|| assert_eq!(ring.swap(At::Forward(index), 1), EMPTY));
        refused(&|| ring.prefetch(At::Forward(index)));
    }
    // One word more would be the next forward word, or a back word.
    for index in [0, 2] {
        refused(&|| ring.write_cell(index, &[1; CELL_WORDS + 1]));
        refused(&|| ring.read_cell(index, &mut [0; CELL_WORDS + 1]));
    }
    let mut all = Vec::new();
    reopened(&fd).read_to_end(&mut all).expect("the file");
    assert!(all.iter().all(|it| *it == 0));
}

#[test]
fn a_word_that_one_side_writes_the_other_side_sees() {
    for (depth, window) in LAYOUTS {
        let (ours, fd) = Ring::create(layout(depth, window)).expect("a ring");
        let theirs = Ring::map(&ring_file(&fd), layout(depth, window)).expect("a mapping");
        // Mappings stay valid after the descriptor is closed.
        drop(fd);
        for (n, (at, _)) in (1..).zip(words(depth, window)) {
            assert_eq!(ours.swap(at, n), EMPTY, "{at:?}");
            assert_eq!(theirs.load(at), n);
            assert!(!theirs.take(at, n + 1), "`take` fails for another value");
            assert!(theirs.take(at, n));
            assert_eq!(ours.load(at), EMPTY);
            theirs.swap(at, n + 7);
            assert_eq!(ours.swap(at, EMPTY), n + 7);
        }
        ours.fence();
    }
}

/// Two threads each change the words that the other one wrote: no word is lost or seen twice.
#[test]
fn two_mappings_hand_words_over_one_by_one() {
    let (ours, fd) = Ring::create(layout(1, 2)).expect("a ring");
    let theirs = Ring::map(&ring_file(&fd), layout(1, 2)).expect("a mapping");
    let other = std::thread::spawn(move || {
        for n in 1..=ROUNDS {
            while !theirs.take(At::Forward(0), n) {
                std::thread::yield_now();
            }
            assert_eq!(theirs.swap(At::Back((n % 2) as u32), n), EMPTY);
        }
    });
    for n in 1..=ROUNDS {
        assert_eq!(ours.swap(At::Forward(0), n), EMPTY);
        while !ours.take(At::Back((n % 2) as u32), n) {
            std::thread::yield_now();
        }
    }
    other.join().expect("the other side");
}

//= SM2-RNG-002 test
#[test]
fn nobody_can_change_the_size_of_a_ring_or_add_a_seal() {
    let (ring, fd) = Ring::create(layout(8, 12)).expect("a ring");
    let file = File::from(fd);
    for size in [0, 4095, 4097, 8192] {
        assert_eq!(ftruncate(&file, size), Err(Errno::EPERM), "{size}");
    }
    assert!(file.write_all_at(&[1], 4096).is_err(), "grown by a write");
    let grow = fallocate(&file, FallocateFlags::empty(), 0, 8192);
    assert_eq!(grow, Err(Errno::EPERM));
    for seal in [SealFlag::F_SEAL_WRITE, SealFlag::from_bits_retain(0x10)] {
        let sealed = fcntl(&file, FcntlArg::F_ADD_SEALS(seal));
        assert_eq!(sealed, Err(Errno::EPERM), "{seal:?}");
    }
    // A page that was punched out is replaced by a page of zeroes.
    ring.swap(At::Back(11), 5);
    let punch = FallocateFlags::FALLOC_FL_PUNCH_HOLE | FallocateFlags::FALLOC_FL_KEEP_SIZE;
    fallocate(&file, punch, 0, 4096).expect("a hole");
    assert_eq!(ring.swap(At::Back(11), 6), EMPTY);
    assert_eq!(ring.load(At::Back(11)), 6);
}

#[test]
fn a_descriptor_that_is_not_open_for_writing_is_an_error_and_no_fault() {
    let (_ring, fd) = Ring::create(layout(8, 12)).expect("a ring");
    let read_only = reopened(&fd);
    let error = Ring::map(&ring_file(&read_only), layout(8, 12)).expect_err("read-only");
    assert_eq!(error.kind(), io::ErrorKind::PermissionDenied);
}

#[test]
fn what_is_no_file_is_an_error() {
    let (reader, _writer) = io::pipe().expect("a pipe");
    let error = InspectedFd::new(reader.into())
        .unwrap()
        .into_ring()
        .unwrap_err();
    assert_eq!(error, VerifyError::NotAMemfd);
}

/// The words that two sides hand over.
const ROUNDS: u64 = if cfg!(feature = "slow") { 1_000 } else { 200 };
const IS_THE_OTHER: &str = "SM2_IO_TEST_RING";

#[test]
fn another_process_sees_the_words_and_writes_some() {
    let (ring, fd) = Ring::create(layout(8, 12)).expect("a ring");
    let mut other = Command::new(std::env::current_exe().expect("this test"))
        .args(["--exact", "ring::the_other_process"])
        .env(IS_THE_OTHER, "")
        .stdin(Stdio::from(fd))
        .stdout(Stdio::null())
        .spawn()
        .expect("a process");
    for n in 1..=ROUNDS {
        assert_eq!(ring.swap(At::Forward(n as u32 % 8), n << 40), EMPTY);
        while !ring.take(At::Back(n as u32 % 12), n << 40) {
            assert_eq!(other.try_wait().expect("a child"), None, "after {n} words");
            std::thread::yield_now();
        }
    }
    assert!(other.wait().expect("its end").success());
}

/// The other process of the test above, with the ring as its standard input.
#[test]
fn the_other_process() {
    if std::env::var_os(IS_THE_OTHER).is_none() {
        return;
    }
    let ring = Ring::map(&ring_file(io::stdin()), layout(8, 12)).expect("a mapping");
    for n in 1..=ROUNDS {
        while !ring.take(At::Forward(n as u32 % 8), n << 40) {
            std::thread::yield_now();
        }
        assert_eq!(ring.swap(At::Back(n as u32 % 12), n << 40), EMPTY);
    }
}
