//! A place in memory for the files of tests.

use std::{
    env, fs,
    path::{Path, PathBuf},
};

const MEMORY: &str = "/dev/shm";
/// How long its files may be together at least, in KiB: far more than any test writes. Containers often have less.
const ROOM_KIB: u64 = 2 << 20;

/// A folder in memory, if the system has one with room; else that of temporary files. A test that writes many files in
/// it does not wait for a disk that other programs keep busy.
#[must_use]
pub fn memory() -> PathBuf {
    let mounts = fs::read_to_string("/proc/self/mounts").unwrap_or_default();
    match has_room(&mounts) {
        true => Path::new(MEMORY).to_owned(),
        false => env::temp_dir(),
    }
}

/// Whether the lines of `/proc/self/mounts` have the folder, without a limit that is too small. It has no limit of its
/// own if it may use half of the memory.
fn has_room(mounts: &str) -> bool {
    // The last mount hides those before it.
    let mounted = mounts.lines().rev().find_map(|line| {
        let mut words = line.split(' ').skip(1);
        let (folder, kind, options) = (words.next()?, words.next()?, words.next()?);
        (folder == MEMORY && kind == "tmpfs").then_some(options)
    });
    let size = |options: &str| {
        let mut options = options.split(',');
        let size = options.find_map(|it| it.strip_prefix("size="));
        size.map(|it| {
            it.strip_suffix('k')
                .and_then(|it| it.parse().ok())
                .unwrap_or(0)
        })
    };
    mounted.is_some_and(|it| size(it).is_none_or(|kib: u64| kib >= ROOM_KIB))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_folder_in_memory_has_no_limit_or_a_great_one() {
        for (options, expected) in [
            ("rw,nosuid,nodev,inode64", true),
            ("rw,size=25165824k,nr_inodes=1", true),
            ("rw,size=65536k", false),
            ("rw,size=many", false),
        ] {
            let mounts = format!("proc /proc proc rw 0 0\ntmpfs {MEMORY} tmpfs {options} 0 0\n");
            assert_eq!(has_room(&mounts), expected, "{options}");
        }
        assert!(!has_room("/dev/vda / ext4 rw 0 0\n"));
    }
}
