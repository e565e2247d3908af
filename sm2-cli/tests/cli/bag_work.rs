//! Long work with bags, which a signal ends.

use std::fs;

use nix::sys::signal::Signal;

use crate::common::{Domain, Running, sm2, until};

/// Long enough that several of them are not compressed before the signal comes.
const MESSAGE_BYTES: u64 = 10_000_000;
const COPIES: usize = 60;

/// Records one message of bytes that cannot be compressed.
fn record_message(domain: &Domain, file: &str) {
    let mut state = 1_u64;
    let mut next = || {
        // Numerical Recipes' linear congruential generator; its upper bits are random enough.
        state = state
            .wrapping_mul(6_364_136_223_846_793_005)
            .wrapping_add(1);
        (state >> 56) as u8
    };
    let bytes: Vec<_> = (0..MESSAGE_BYTES).map(|_| next()).collect();
    let path = domain.path("bytes");
    fs::write(&path, bytes).unwrap();
    let recorder = domain.start(&["record", "big", "--reliable", "big", "-o", file]);
    domain.wait_for("big", "subscribers", 1);
    let from = path.to_str().unwrap();
    let options = ["--from", from, "--wait", "1", "--reliable"];
    let published = domain.run(&[&["topic", "pub", "big"], &options[..]].concat());
    assert_eq!(published.code(), 0, "{published:?}");
    recorder.signal(Signal::SIGINT);
    let recorded = recorder.finish();
    assert_eq!(recorded.code(), 0, "{recorded:?}");
}

#[test]
fn ctrl_c_ends_a_copy_and_removes_it() {
    let domain = Domain::new();
    let (bag, copy) = (domain.path("bag.mcap"), domain.path("copy.mcap"));
    let file = bag.to_str().unwrap();
    record_message(&domain, file);
    let mut command = sm2(&["bag", "merge"]);
    command.args([file; COPIES]).args(["--compression", "zstd"]);
    let merge = Running::start(command.arg("-o").arg(&copy));
    until("the copy is begun", || copy.exists());
    merge.signal(Signal::SIGINT);
    let finished = merge.finish();
    assert_eq!(finished.code(), 130, "{finished:?}");
    assert_eq!(finished.stderr(), "");
    assert!(!copy.exists());
}
