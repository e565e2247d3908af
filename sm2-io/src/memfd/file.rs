//! System calls on memory files: creating, allocating, sealing.

use std::fs::File;
use std::io;
use std::os::fd::AsFd;

use nix::errno::Errno;
use nix::libc::off_t;
use sm2_proto::Seals;

use crate::syscall::{files, memory};

/// The limit of locked memory of this process in bytes (`RLIMIT_MEMLOCK`); `u64::MAX` without a
/// limit. It does not bind a process with `CAP_IPC_LOCK`.
///
/// # Errors
///
/// Any error of `getrlimit(2)`. None is expected.
pub fn locked_bytes_max() -> io::Result<u64> {
    Ok(memory::locked_bytes_max()?)
}

/// Creates a memfd of `len` zeroes that can be sealed.
pub(crate) fn create(name: &std::ffi::CStr, len: u64) -> io::Result<File> {
    let file = File::from(memory::memfd(name)?);
    files::set_len(&file, len)?;
    Ok(file)
}

/// Allocates all pages of a file.
pub(crate) fn allocate(file: &File, len: usize) -> io::Result<()> {
    if len == 0 {
        return Ok(());
    }
    let len = off_t::try_from(len).map_err(|_| io::ErrorKind::InvalidInput)?;
    loop {
        // A signal interrupts the allocation of a large file.
        match memory::allocate(file, len) {
            Err(Errno::EINTR) => {}
            result => return result.map_err(io::Error::from),
        }
    }
}

/// Attempts to add a seal that the kernel refuses with `EBUSY`. The kernel waits up to 150 ms in each
/// of them for the holder of a page reference: compaction, or a tool that walks the memory of a
/// process.
const SEAL_TRIES: u32 = 4;

/// Adds `seals` in one step.
pub(crate) fn add_seals(file: impl AsFd, seals: Seals) -> io::Result<()> {
    let mut result = try_seals(&file, seals);
    for _ in 1..SEAL_TRIES {
        match &result {
            Err(error) if error.kind() == io::ErrorKind::ResourceBusy => {}
            _ => break,
        }
        result = try_seals(&file, seals);
    }
    result
}

/// Adds `seals` in one step. `ResourceBusy` means that the kernel refuses for the moment.
pub(crate) fn try_seals(file: impl AsFd, seals: Seals) -> io::Result<()> {
    Ok(memory::add_seals(file, seals.0)?)
}
