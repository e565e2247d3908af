//! Helpers that map files of the tests.

#![allow(dead_code, reason = "each test uses some of it")]

use std::os::fd::{AsFd, OwnedFd};
use std::time::{Duration, Instant};

use nix::sys::signal::{Signal, kill};
use nix::sys::wait::{WaitPidFlag, WaitStatus, waitpid};
use nix::unistd::Pid;
use sm2_test_support::SOON;

use sm2_io::memfd::{PooledFile, RingFile, SealedFile};
use sm2_io::{InspectedFd, PooledMapping, SealedMapping};

/// Waits until a child that was made by `fork(2)` has ended without an error.
pub(crate) fn until_exited(child: Pid) {
    let deadline = Instant::now() + SOON;
    loop {
        match waitpid(child, Some(WaitPidFlag::WNOHANG)).unwrap() {
            WaitStatus::StillAlive if Instant::now() < deadline => {
                std::thread::sleep(Duration::from_millis(1));
            }
            WaitStatus::StillAlive => {
                kill(child, Signal::SIGKILL).unwrap();
                waitpid(child, None).unwrap();
                panic!("the child does not end");
            }
            ended => {
                assert_eq!(ended, WaitStatus::Exited(child, 0));
                return;
            }
        }
    }
}

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
