//! Sealed copies by `pwrite(2)`.

use std::io::{self, IoSlice};
use std::os::fd::OwnedFd;

use sm2_proto::Seals;

use super::file::{add_seals, create};
use crate::syscall::files;

/// Creates a sealed memfd with the concatenation of `parts`, which may be empty. No process can change
/// its bytes or its size.
///
/// # Errors
///
/// Any error of `memfd_create(2)`, `ftruncate(2)` and `pwrite(2)`, such as too many descriptors or no
/// memory. `InvalidInput` if the lengths do not add up to a file's size.
pub fn sealed_from_parts(parts: &[IoSlice<'_>]) -> io::Result<OwnedFd> {
    let len = parts
        .iter()
        .try_fold(0_u64, |sum, part| sum.checked_add(part.len() as u64))
        .ok_or(io::ErrorKind::InvalidInput)?;
    let file = create(c"sm2-message", len)?;
    let mut offset = 0;
    for part in parts {
        files::write_all_at(&file, part, offset)?;
        offset += part.len() as u64;
    }
    add_seals(&file, Seals::SEALED)?;
    Ok(file.into())
}
