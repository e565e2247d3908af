//! The file of a recorder, behind a trait.

use std::fs::{File, OpenOptions};
use std::io;
use std::os::unix::fs::{FileExt, OpenOptionsExt};
use std::path::Path;
use std::sync::Arc;

use nix::errno::Errno;
use nix::fcntl::OFlag;
use nix::sys::statvfs::fstatvfs;

/// The length of a block, in bytes. Disks that want longer ones are rare, and refuse (`EINVAL`).
pub(crate) const BLOCK_BYTES: usize = 4_096;

/// How many bytes the disk of a file can still take.
pub type FreeBytes = fn(&File) -> io::Result<u64>;

/// As `fstatvfs(3)` says.
pub(crate) fn free_bytes(file: &File) -> io::Result<u64> {
    let disk = fstatvfs(file)?;
    Ok(disk.blocks_available() * disk.fragment_size())
}

/// Writes everything to the disk that was written before it was made.
pub type SyncWork = Box<dyn FnOnce() -> io::Result<()> + Send>;

/// The file that a recorder writes. Tests put a disk that is full, slow or torn in its place.
pub trait Storage: Send {
    /// Writes all `bytes` at `offset`, in bytes from the start of the file.
    ///
    /// # Errors
    ///
    /// Any error of `pwrite(2)`. A part of the bytes may have been written.
    fn write_at(&mut self, bytes: &[u8], offset: u64) -> io::Result<()>;

    /// Writes whole blocks of 4,096 bytes. The address of `blocks` and `offset` are multiples of 4,096 as well, so that
    /// the disk can read the memory of the caller.
    ///
    /// # Errors
    ///
    /// As those of [`write_at`](Self::write_at).
    fn write_blocks_at(&mut self, blocks: &[u8], offset: u64) -> io::Result<()> {
        self.write_at(blocks, offset)
    }

    /// Writes everything to the disk that was written before.
    ///
    /// # Errors
    ///
    /// Any error of `fdatasync(2)`.
    fn sync(&mut self) -> io::Result<()>;

    /// Begins a [`sync`](Self::sync): another thread runs the result while this one goes on writing. `None`, the
    /// default: writing waits for `sync`.
    ///
    /// # Errors
    ///
    /// Any error of the operating system.
    fn begin_sync(&mut self) -> io::Result<Option<SyncWork>> {
        Ok(None)
    }

    /// How many bytes the disk can still take; `None` if that is unknown.
    ///
    /// # Errors
    ///
    /// Any error of `fstatvfs(3)`.
    fn free_bytes(&self) -> io::Result<Option<u64>> {
        Ok(None)
    }
}

impl Storage for File {
    fn write_at(&mut self, bytes: &[u8], offset: u64) -> io::Result<()> {
        self.write_all_at(bytes, offset)
    }

    fn sync(&mut self) -> io::Result<()> {
        self.sync_data()
    }
}

/// A new file that gets large payloads without the page cache (`O_DIRECT`). Everything else goes through the page
/// cache; so does all if the file system has no `O_DIRECT`.
#[derive(Debug)]
pub struct BagFile {
    /// Shared with a synchronization, which needs no descriptor of its own.
    file: Arc<File>,
    /// The same file.
    direct: Option<File>,
    free_bytes: FreeBytes,
}

impl BagFile {
    /// Creates the file.
    ///
    /// # Errors
    ///
    /// Any error of `open(2)`; also if the file exists.
    pub fn create(path: &Path) -> io::Result<Self> {
        let file = OpenOptions::new().write(true).create_new(true).open(path)?;
        // Tells readers that it is being written. Some file systems have no locks.
        let _ = sm2_io::lock_file(&file);
        let flags = OFlag::O_DIRECT.bits();
        let opened = OpenOptions::new()
            .write(true)
            .custom_flags(flags)
            .open(path);
        let direct = match opened {
            Ok(direct) => Some(direct),
            Err(error) if is_unsupported(&error) => None,
            Err(error) => return Err(error),
        };
        sync_parent(path)?;
        Ok(Self {
            file: Arc::new(file),
            direct,
            free_bytes,
        })
    }

    /// The file, whose disk can take as much as this function says.
    pub(crate) fn with_free_bytes(self, free_bytes: FreeBytes) -> Self {
        Self { free_bytes, ..self }
    }
}

impl Storage for BagFile {
    fn write_at(&mut self, bytes: &[u8], offset: u64) -> io::Result<()> {
        self.file.write_all_at(bytes, offset)
    }

    fn write_blocks_at(&mut self, blocks: &[u8], offset: u64) -> io::Result<()> {
        if let Some(direct) = &self.direct {
            match direct.write_all_at(blocks, offset) {
                Err(error) if is_unsupported(&error) => self.direct = None,
                result => return result,
            }
        }
        self.write_at(blocks, offset)
    }

    fn sync(&mut self) -> io::Result<()> {
        // Both descriptors are of the same file.
        self.file.sync_data()
    }

    fn begin_sync(&mut self) -> io::Result<Option<SyncWork>> {
        let file = Arc::clone(&self.file);
        Ok(Some(Box::new(move || file.sync_data())))
    }

    fn free_bytes(&self) -> io::Result<Option<u64>> {
        (self.free_bytes)(&self.file).map(Some)
    }
}

/// Whether a disk, a quota or the limit for the length of files is full.
pub(crate) fn is_full(error: &io::Error) -> bool {
    let full = [Errno::ENOSPC, Errno::EDQUOT, Errno::EFBIG];
    let is = |it: &Errno| error.raw_os_error() == Some(*it as i32);
    full.iter().any(is)
}

/// Whether the file system or the disk refuses `O_DIRECT`.
fn is_unsupported(error: &io::Error) -> bool {
    error.raw_os_error() == Some(Errno::EINVAL as i32)
}

/// Makes the entry of a new file safe against a power cut.
fn sync_parent(path: &Path) -> io::Result<()> {
    let parent = match path.parent() {
        Some(parent) if parent != Path::new("") => parent,
        _ => Path::new("."),
    };
    match File::open(parent)?.sync_all() {
        // Some file systems cannot synchronize folders.
        Err(error) if error.kind() == io::ErrorKind::InvalidInput => Ok(()),
        result => result,
    }
}

#[cfg(test)]
mod tests {
    use sm2_test_support::memory;

    use super::*;

    /// A file grows by no more than the free bytes of its disk.
    #[test]
    fn free_bytes_are_those_that_can_be_written() {
        const LEN_BYTES: usize = 1 << 20;
        let file = tempfile::tempfile_in(memory()).unwrap();
        let free = free_bytes(&file).unwrap();
        file.write_all_at(&vec![7; LEN_BYTES], 0).unwrap();
        assert!(free >= LEN_BYTES as u64, "{free}");
        // Nobody has a disk of an exabyte.
        assert!(free < 1 << 60, "{free}");
    }
}
