//! Helpers that map files of the tests.

#![allow(dead_code, reason = "each test uses some of it")]

use std::os::fd::{AsFd, OwnedFd};

use sm2_io::memfd::{PooledFile, RingFile, SealedFile};
use sm2_io::{InspectedFd, PooledMapping, SealedMapping};

fn owned(fd: impl AsFd) -> OwnedFd {
    fd.as_fd().try_clone_to_owned().unwrap()
}

pub(crate) fn sealed_file(fd: impl AsFd) -> SealedFile {
    InspectedFd::new(owned(fd)).unwrap().into_sealed().unwrap()
}

pub(crate) fn pooled_file(fd: impl AsFd) -> PooledFile {
    InspectedFd::new(owned(fd)).unwrap().into_pooled().unwrap()
}

pub(crate) fn ring_file(fd: impl AsFd) -> RingFile {
    InspectedFd::new(owned(fd)).unwrap().into_ring().unwrap()
}

pub(crate) fn map_sealed(fd: impl AsFd, len: u64, populate: bool) -> SealedMapping {
    SealedMapping::new(&sealed_file(fd), len, populate).unwrap()
}

pub(crate) fn map_pooled(fd: impl AsFd, len: u64) -> PooledMapping {
    PooledMapping::new(&pooled_file(fd), len, false).unwrap()
}
