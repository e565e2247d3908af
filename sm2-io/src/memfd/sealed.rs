//! Sealed copies by the fastest method.

use std::io::{self, IoSlice};
use std::os::fd::OwnedFd;

use super::copy::sealed_from_parts;
use super::loan::SealedLoan;

/// Creates a sealed memfd with a copy of `bytes`: through a mapping of huge pages if `bytes` is long and
/// the kernel has huge pages, else as [`sealed_from_parts`]. The file is as long as `bytes`.
///
/// # Errors
///
/// As [`sealed_from_parts`].
pub fn sealed_from_bytes(bytes: &[u8]) -> io::Result<OwnedFd> {
    match SealedLoan::of_huge_pages(bytes.len())? {
        Some(loan) => loan.filled(bytes),
        None => sealed_from_parts(&[IoSlice::new(bytes)]),
    }
}
