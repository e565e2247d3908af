//! Files to attach: memory files with exactly the seals that a test needs, and other files.

use std::{
    fs::File,
    io,
    os::fd::{AsRawFd, OwnedFd},
};

use nix::{
    fcntl::{FcntlArg, SealFlag, fcntl},
    sys::memfd::{MFdFlags, memfd_create},
};
use sm2_proto::Seals;

/// A memory file of `len` zeroes with these seals.
#[must_use]
pub fn memfd(len: u64, seals: Seals) -> OwnedFd {
    create(len, MFdFlags::empty(), seals).expect("a memory file")
}

/// A memory file of huge pages with all existing seals, or [`null`] if the kernel has no huge
/// pages.
#[must_use]
pub fn huge() -> OwnedFd {
    let all = Seals(Seals::SEALED.0 | Seals::POOLED.0);
    create(0, MFdFlags::MFD_HUGETLB, all).unwrap_or_else(|_| null())
}

fn create(len: u64, kind: MFdFlags, seals: Seals) -> io::Result<OwnedFd> {
    let flags = MFdFlags::MFD_CLOEXEC | MFdFlags::MFD_ALLOW_SEALING | kind;
    let file = File::from(memfd_create(c"sm2-test", flags)?);
    file.set_len(len)?;
    let seals = SealFlag::from_bits_retain(seals.0.cast_signed());
    fcntl(&file, FcntlArg::F_ADD_SEALS(seals))?;
    Ok(file.into())
}

/// `seals` without those in `missing`.
#[must_use]
pub const fn without(seals: Seals, missing: Seals) -> Seals {
    Seals(seals.0 & !missing.0)
}

/// A file that is legal for a sealed payload of `len` bytes.
#[must_use]
pub fn sealed(len: u64) -> OwnedFd {
    memfd(len, Seals::SEALED)
}

/// A file that is legal as a segment of `len` bytes.
#[must_use]
pub fn segment(len: u64) -> OwnedFd {
    memfd(len, Seals::POOLED)
}

/// An open file that can never be mapped as a payload.
#[must_use]
pub fn null() -> OwnedFd {
    File::open("/dev/null").expect("/dev/null").into()
}

/// The same memory file, opened only for reading.
#[must_use]
pub fn reopened(file: &OwnedFd) -> OwnedFd {
    File::open(path(file)).expect("the same file").into()
}

/// The same memory file, opened only for writing.
#[must_use]
pub fn write_only(file: &OwnedFd) -> OwnedFd {
    let file = File::options().write(true).open(path(file));
    file.expect("the same file").into()
}

fn path(file: &OwnedFd) -> String {
    format!("/proc/self/fd/{}", file.as_raw_fd())
}
