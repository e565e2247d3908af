//! Another process tries to change memory between its verification and its use. Each attempt fails, or does
//! not affect copies.

use std::fs::File;
use std::io;
use std::os::fd::{AsFd, OwnedFd};

use crate::common::{map_pooled, pooled_file, ring_file, sealed_file};
use nix::fcntl::{FallocateFlags, FcntlArg, SealFlag, fallocate, fcntl};
use nix::libc;
use nix::sys::memfd::{MFdFlags, memfd_create};
use sm2_io::memfd::sealed_from_bytes;
use sm2_io::{InspectedFd, PooledMapping, Ring, SealedMapping, Segment, VerifyError};
use sm2_proto::Seals;
use sm2_proto::link::{CELL_WORDS, RingLayout, RingMemory};

const PAGE: u64 = 4096;

fn memfd(len: u64, seals: Seals) -> File {
    let file = memfd_create(c"sm2-test", MFdFlags::MFD_ALLOW_SEALING).unwrap();
    let file = File::from(file);
    file.set_len(len).unwrap();
    seal(&file, seals);
    file
}

fn seal(file: &File, seals: Seals) {
    let flags = SealFlag::from_bits_retain(seals.0.cast_signed());
    fcntl(file, FcntlArg::F_ADD_SEALS(flags)).unwrap();
}

fn inspected(file: &File) -> InspectedFd {
    InspectedFd::new(file.try_clone().unwrap().into()).unwrap()
}

fn without(seals: Seals, missing: Seals) -> Seals {
    Seals(seals.0 & !missing.0)
}

//= SM2-SEG-001 test
#[test]
fn a_file_without_the_seals_proves_nothing() {
    let not_sealed = |found: Seals, needed| {
        Err(VerifyError::SealsMissing {
            seals: found,
            needed,
        })
    };
    for missing in [Seals::SEAL, Seals::SHRINK, Seals::GROW, Seals::WRITE] {
        let seals = without(Seals::SEALED, missing);
        let proof = inspected(&memfd(PAGE, seals)).into_sealed();
        assert_eq!(proof.map(drop), not_sealed(seals, Seals::SEALED));
    }
    for missing in [Seals::SEAL, Seals::SHRINK, Seals::GROW, Seals::FUTURE_WRITE] {
        let seals = without(Seals::POOLED, missing);
        let proof = inspected(&memfd(PAGE, seals)).into_pooled();
        assert_eq!(proof.map(drop), not_sealed(seals, Seals::POOLED));
    }
    for missing in [Seals::SEAL, Seals::SHRINK, Seals::GROW] {
        let seals = without(Seals::RING, missing);
        let proof = inspected(&memfd(PAGE, seals)).into_ring();
        assert_eq!(proof.map(drop), not_sealed(seals, Seals::RING));
    }
    let socket: OwnedFd = sm2_io::SeqPacket::pair().unwrap().0.into();
    let proof = InspectedFd::new(socket).unwrap().into_sealed().map(drop);
    assert_eq!(proof, Err(VerifyError::NotAMemfd));
}

/// Facts are those of the moment of inspection: seals that are added later prove nothing.
#[test]
fn a_file_that_is_sealed_after_it_was_inspected_proves_nothing() {
    let file = memfd(2 * PAGE, Seals(0));
    let inspected = inspected(&file);
    file.set_len(PAGE).unwrap();
    seal(&file, Seals::SEALED);
    let error = inspected.into_sealed().unwrap_err();
    let needed = Seals::SEALED;
    let seals = Seals(0);
    assert_eq!(error, VerifyError::SealsMissing { seals, needed });
}

/// Reading past the end of a file would kill the reader, so no mapping is longer than its file.
#[test]
fn nothing_is_mapped_beyond_the_end_of_a_file() {
    let invalid = |result: io::Result<()>| {
        let error = result.expect_err("longer than the file");
        assert_eq!(error.kind(), io::ErrorKind::InvalidInput);
    };
    let sealed = sealed_file(sealed_from_bytes(&[1; 100]).unwrap());
    invalid(SealedMapping::new(&sealed, 101, false).map(drop));
    let segment = Segment::create(PAGE, 2).unwrap();
    let pooled = pooled_file(segment.fd());
    invalid(PooledMapping::new(&pooled, 2 * PAGE + 1, true).map(drop));
    let layout = RingLayout::new(8, 12).unwrap();
    let short = memfd(layout.size_bytes() - 1, Seals::RING);
    invalid(Ring::map(&ring_file(&short), layout).map(drop));
}

#[test]
fn a_verified_file_cannot_become_shorter() {
    let (ring, ring_fd) = Ring::create(RingLayout::new(8, 12).unwrap()).unwrap();
    let segment = Segment::create(PAGE, 1).unwrap();
    let files = [
        OwnedFd::from(sealed_file(sealed_from_bytes(&[1; 100]).unwrap())),
        OwnedFd::from(pooled_file(segment.fd())),
        OwnedFd::from(ring_file(&ring_fd)),
    ];
    for file in files.map(File::from) {
        let len = file.metadata().unwrap().len();
        for other in [0, len - 1, len + 1] {
            let error = file.set_len(other).expect_err("its size is sealed");
            assert_eq!(error.raw_os_error(), Some(libc::EPERM));
        }
    }
    drop(ring);
}

/// The author of a segment can write to it at any time; copies do not change.
#[test]
fn a_copy_of_pooled_memory_stays_as_it_is() {
    let (fd, mut slots) = Segment::create(PAGE, 1).unwrap().split();
    slots[0].bytes_mut(PAGE as usize).fill(1);
    let mapping = map_pooled(fd.as_fd(), PAGE);
    let (vector, array) = (mapping.copy_to_vec(0, PAGE), mapping.copy::<64>(128));
    slots[0].bytes_mut(PAGE as usize).fill(2);
    assert!(vector.unwrap().iter().all(|&byte| byte == 1));
    assert_eq!(array, Some([1; 64]));
    assert_eq!(mapping.copy::<8>(0), Some([2; 8]));
}

/// The other side of a ring can write a cell at any time; a copy does not change.
//= SM2-RNG-013 test
#[test]
fn a_copy_of_a_cell_stays_as_it_is() {
    let layout = RingLayout::new(8, 12).unwrap();
    let (ours, fd) = Ring::create(layout).unwrap();
    let theirs = Ring::map(&ring_file(&fd), layout).unwrap();
    theirs.write_cell(7, &[1; CELL_WORDS]);
    let mut copy = [0; CELL_WORDS];
    ours.read_cell(7, &mut copy);
    theirs.write_cell(7, &[2; CELL_WORDS]);
    assert_eq!(copy, [1; CELL_WORDS]);
    // A file whose pages are taken away reads as zeroes, and the mapping stays valid.
    let punch = FallocateFlags::FALLOC_FL_PUNCH_HOLE | FallocateFlags::FALLOC_FL_KEEP_SIZE;
    fallocate(&fd, punch, 0, layout.size_bytes().cast_signed()).unwrap();
    ours.read_cell(7, &mut copy);
    assert_eq!(copy, [0; CELL_WORDS]);
}
