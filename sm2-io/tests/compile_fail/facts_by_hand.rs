//! Facts cannot be constructed by hand: they belong to no descriptor.

use std::os::fd::OwnedFd;

use sm2_io::InspectedFd;
use sm2_proto::{FdFacts, Seals};

fn forge(fd: OwnedFd) -> InspectedFd {
    let facts = FdFacts {
        regular: true,
        size_bytes: 1 << 20,
        seals: Seals::SEALED,
    };
    InspectedFd { fd, facts }
}

fn main() {}
