//! Memory that mapping a file costs its receiver.

// Shows DAT-COST (test), bound: the kernel of this machine.

use sm2_test_support::ran_alone;
use std::fs::{self, File};
use std::os::unix::fs::{FileExt, MetadataExt};

use nix::fcntl::{FcntlArg, SealFlag, fcntl};
use nix::sys::memfd::{MFdFlags, memfd_create};

use crate::common::map_sealed;

const MIB: u64 = 1 << 20;

/// A sealed file of `len` bytes that has memory only from each of `starts` on, one MiB each.
fn sealed(len: u64, starts: &[u64]) -> File {
    let flags = MFdFlags::MFD_CLOEXEC | MFdFlags::MFD_ALLOW_SEALING;
    let file = File::from(memfd_create("holes", flags).unwrap());
    file.set_len(len).unwrap();
    for start in starts {
        file.write_all_at(&vec![1; MIB as usize], *start).unwrap();
    }
    fcntl(&file, FcntlArg::F_ADD_SEALS(SealFlag::all())).unwrap();
    file
}

/// The bytes of memory that the file has.
fn allocated(file: &File) -> u64 {
    file.metadata().unwrap().blocks() * 512
}

/// The bytes of the mapping at `address` that are present in this process.
fn resident(address: *const u8) -> u64 {
    let start = format!("{:x}-", address.addr());
    let maps = fs::read_to_string("/proc/self/smaps").unwrap();
    let mut lines = maps.lines().skip_while(|line| !line.starts_with(&start));
    let line = lines.find_map(|line| line.strip_prefix("Rss:")).unwrap();
    let kib = line.trim().strip_suffix(" kB").unwrap();
    kib.parse::<u64>().unwrap() * 1024
}

//= SM2-PAY-009 test
#[test]
fn a_hole_costs_its_receiver_nothing() {
    if ran_alone(concat!(
        module_path!(),
        "::a_hole_costs_its_receiver_nothing"
    )) {
        return;
    }
    const LEN: u64 = 1024 * MIB;
    let cases: [&[u64]; 4] = [&[], &[0], &[LEN - MIB], &[0, LEN - MIB]];
    for starts in cases {
        let file = sealed(LEN, starts);
        let before = allocated(&file);
        let mapping = map_sealed(&file, LEN, true);
        assert_eq!(resident(mapping.as_ptr()), 0, "{starts:?}");
        assert_eq!(allocated(&file), before, "{starts:?}");
        assert_eq!(
            mapping[LEN as usize - 1],
            u8::from(starts.contains(&(LEN - MIB)))
        );
    }
}

/// A hole behind the message does not matter.
//= SM2-PAY-009 test
#[test]
fn a_message_without_holes_is_present_at_once() {
    if ran_alone(concat!(
        module_path!(),
        "::a_message_without_holes_is_present_at_once"
    )) {
        return;
    }
    let file = sealed(64 * MIB, &[0, MIB]);
    let before = allocated(&file);
    let mapping = map_sealed(&file, 2 * MIB, true);
    assert_eq!(resident(mapping.as_ptr()), 2 * MIB);
    assert_eq!(allocated(&file), before);
    assert_eq!(resident(map_sealed(&file, 2 * MIB, false).as_ptr()), 0);
}
