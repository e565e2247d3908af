//! A descriptor alone proves nothing: its file could shrink under the mapping.

use std::os::fd::OwnedFd;

use sm2_io::SealedMapping;

fn map(fd: &OwnedFd) {
    let _ = SealedMapping::new(fd, 1, false);
}

fn main() {}
