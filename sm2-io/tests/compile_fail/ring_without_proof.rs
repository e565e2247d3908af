//! A descriptor alone proves nothing: its file could shrink under the words.

use std::os::fd::OwnedFd;

use sm2_io::Ring;
use sm2_proto::link::RingLayout;

fn map(fd: &OwnedFd, layout: RingLayout) {
    let _ = Ring::map(fd, layout);
}

fn main() {}
