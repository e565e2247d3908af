//! Writes blocks to a file, to measure the disk alone.

use std::{
    fs::{File, OpenOptions},
    io,
    num::NonZero,
    os::unix::fs::{FileExt, OpenOptionsExt},
    slice,
};

use nix::{
    fcntl::OFlag,
    sys::mman::{MapFlags, MmapAdvise, ProtFlags, madvise, mmap_anonymous},
    unistd::Pid,
};

use super::Failure;
use crate::{
    clock::now_ns,
    control::{Stage, send_event, wait_for},
    job::{DiskWork, Outcome, ProcessEvent, Recorded},
    measure,
};

/// The length of a block, in bytes: `O_DIRECT` needs its multiples.
const BLOCK_BYTES: usize = 4_096;

/// The length of a huge page, in bytes.
const HUGE_BYTES: usize = 2 << 20;

/// Writes the blocks with `O_DIRECT`, one write after the other, and synchronizes the file at the interval and at the
/// end.
pub(super) fn write(work: &DiskWork) -> Result<Outcome, Failure> {
    let len = work.len.next_multiple_of(BLOCK_BYTES);
    let blocks = memory(len)?;
    send_event(&ProcessEvent::Ready)?;
    wait_for(Stage::Go);
    let cpu_ns = measure::cpu_ns(Pid::this())?;
    let start_ns = now_ns();
    let file = create(work)?;
    let interval_ns = work.sync_ms * 1_000_000;
    let mut sync_at_ns = start_ns + interval_ns;
    for number in 0..work.count {
        file.write_all_at(blocks, number * len as u64)?;
        if now_ns() >= sync_at_ns {
            file.sync_data()?;
            sync_at_ns = now_ns() + interval_ns;
        }
    }
    file.sync_data()?;
    Ok(Outcome::Recorded(Recorded {
        start_ns,
        done_ns: now_ns(),
        cpu_ns: measure::cpu_ns(Pid::this())? - cpu_ns,
        file_bytes: work.count * len as u64,
    }))
}

/// Written memory that stays mapped until the process ends, in huge pages if the system has them: a disk takes fewer
/// and longer requests from memory in one piece.
fn memory(len: usize) -> io::Result<&'static [u8]> {
    let mapped = len.next_multiple_of(HUGE_BYTES) + HUGE_BYTES;
    let size = NonZero::new(mapped).ok_or(io::ErrorKind::InvalidInput)?;
    let protection = ProtFlags::PROT_READ | ProtFlags::PROT_WRITE;
    // SAFETY: the kernel chooses an unused place.
    let start = unsafe { mmap_anonymous(None, size, protection, MapFlags::MAP_PRIVATE) }?;
    // SAFETY: the range is the mapping that was just made, which nothing refers to yet. A kernel without huge pages
    // refuses, and the pages stay short.
    let _ = unsafe { madvise(start, mapped, MmapAdvise::MADV_HUGEPAGE) };
    // SAFETY: the mapping is readable and writable, zeroed, as long as the slice, and never unmapped.
    let memory = unsafe { slice::from_raw_parts_mut(start.cast::<u8>().as_ptr(), mapped) };
    memory.fill(0x5a);
    let skipped = memory.as_ptr().align_offset(HUGE_BYTES);
    Ok(&memory[skipped..][..len])
}

fn create(work: &DiskWork) -> io::Result<File> {
    let mut options = OpenOptions::new();
    let options = options.write(true).create_new(true);
    options
        .custom_flags(OFlag::O_DIRECT.bits())
        .open(&work.file)
}
