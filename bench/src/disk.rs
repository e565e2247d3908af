//! The folder of recorded files: it must be on a real disk with enough room.

use std::{
    env, io,
    path::{Path, PathBuf},
};

use nix::sys::{
    statfs::{FsType, TMPFS_MAGIC, statfs},
    statvfs::statvfs,
};
use tempfile::TempDir;

/// `RAMFS_MAGIC` of Linux, which `nix` does not have.
const RAMFS_MAGIC: FsType = FsType(0x8584_58f6);

/// The room that stays free beside the files of a run, in bytes.
const RESERVE_BYTES: u64 = 2_000_000_000;

/// The reason why a folder cannot take the files of a run.
#[derive(Debug, thiserror::Error)]
pub enum DiskError {
    /// Its files are in memory.
    #[error("{} is in memory, not on a disk: choose another folder with --folder", .0.display())]
    InMemory(PathBuf),
    /// The disk is too full.
    #[error(
        "the disk of {} has {} MB free, and {} MB are needed: choose fewer --gigabytes or another --folder",
        .folder.display(), .free / 1_000_000, .needed / 1_000_000
    )]
    Full {
        /// The folder.
        folder: PathBuf,
        /// The free room, in bytes.
        free: u64,
        /// The room that the run needs, in bytes.
        needed: u64,
    },
    /// The folder cannot be used.
    #[error("cannot use the folder {}: {source}", .folder.display())]
    Io {
        /// The folder.
        folder: PathBuf,
        /// The error of the system.
        r#source: io::Error,
    },
}

/// Makes a folder for files of `bytes` in total, below `folder` or the system's folder for temporary files. It is
/// removed when the value is dropped.
///
/// # Errors
///
/// See [`DiskError`].
pub fn scratch(folder: Option<&Path>, bytes: u64) -> Result<TempDir, DiskError> {
    let folder = folder.map_or_else(env::temp_dir, Path::to_owned);
    check(&folder)?;
    let failed = |source| DiskError::Io {
        folder: folder.clone(),
        source,
    };
    let disk = statvfs(&folder).map_err(|errno| failed(errno.into()))?;
    let free = disk.blocks_available() * disk.fragment_size();
    let needed = bytes.saturating_add(RESERVE_BYTES);
    if free < needed {
        return Err(DiskError::Full {
            folder,
            free,
            needed,
        });
    }
    let builder = tempfile::Builder::new()
        .prefix("sm2-bench-")
        .tempdir_in(&folder);
    builder.map_err(failed)
}

/// Checks that a folder exists on a disk.
///
/// # Errors
///
/// See [`DiskError`].
pub fn check(folder: &Path) -> Result<(), DiskError> {
    let found = statfs(folder).map_err(|errno| DiskError::Io {
        folder: folder.to_owned(),
        source: errno.into(),
    })?;
    match found.filesystem_type() {
        TMPFS_MAGIC | RAMFS_MAGIC => Err(DiskError::InMemory(folder.to_owned())),
        _ => Ok(()),
    }
}

#[cfg(test)]
mod tests {
    use super::{DiskError, check, scratch};
    use std::{env, path::Path};

    #[test]
    fn folders_in_memory_and_missing_ones_are_refused() {
        let memory = check(Path::new("/dev/shm"));
        assert!(matches!(memory, Err(DiskError::InMemory(_))), "{memory:?}");
        let missing = check(Path::new("/no such folder"));
        assert!(matches!(missing, Err(DiskError::Io { .. })), "{missing:?}");
    }

    #[test]
    fn a_folder_needs_room_and_goes_when_it_is_dropped() {
        // The build's folder is on a disk.
        let folder = env::current_exe().unwrap();
        let folder = folder.parent().unwrap();
        let full = scratch(Some(folder), 1 << 60);
        assert!(matches!(full, Err(DiskError::Full { .. })), "{full:?}");
        let there = scratch(Some(folder), 0).unwrap();
        let path = there.path().to_owned();
        assert!(path.is_dir());
        drop(there);
        assert!(!path.exists());
    }
}
