//! Memory that is never swapped out. In its own file: the test lowers a limit of the process.

use sm2_test_support::ran_alone;
use std::io;

use nix::libc;
use nix::sys::resource::{Resource, setrlimit};
use sm2_io::Segment;
use sm2_io::memfd::locked_bytes_max;

/// Returns the locked memory of this process in bytes, from `/proc`.
fn locked() -> usize {
    let status = std::fs::read_to_string("/proc/self/status").unwrap();
    let line = status.lines().find(|line| line.starts_with("VmLck:"));
    let kibibytes = line.unwrap().split_whitespace().nth(1).unwrap();
    kibibytes.parse::<usize>().unwrap() * 1024
}

/// Drops all capabilities of the calling thread.
fn drop_capabilities() {
    // `_LINUX_CAPABILITY_VERSION_3`, and 0 for the calling thread.
    let (header, none) = ([0x2008_0522_u32, 0], [0_u32; 6]);
    // SAFETY: capset(2) reads two words of header and six of capabilities; both arrays outlive
    // the call.
    let result = unsafe { libc::syscall(libc::SYS_capset, header.as_ptr(), none.as_ptr()) };
    assert_eq!(result, 0, "{}", io::Error::last_os_error());
}

#[test]
fn a_segment_is_locked_up_to_the_limit() {
    if ran_alone(concat!(
        module_path!(),
        "::a_segment_is_locked_up_to_the_limit"
    )) {
        return;
    }
    let limit = 64 << 10;
    drop_capabilities();
    setrlimit(Resource::RLIMIT_MEMLOCK, limit, limit).unwrap();
    assert_eq!(locked_bytes_max().unwrap(), limit);

    let mut segment = Segment::create(4096, 4).unwrap();
    assert_eq!(locked(), 0);
    segment.lock().unwrap();
    assert_eq!(locked(), 4 * 4096);
    let mut too_large = Segment::create(limit, 1).unwrap();
    let error = too_large.lock().unwrap_err();
    assert_eq!(error.kind(), io::ErrorKind::OutOfMemory, "{error}");
    drop(segment);
    assert_eq!(locked(), 0);
    too_large.lock().unwrap();

    setrlimit(Resource::RLIMIT_MEMLOCK, 0, 0).unwrap();
    let error = Segment::create(4096, 1).unwrap().lock().unwrap_err();
    assert_eq!(error.kind(), io::ErrorKind::PermissionDenied, "{error}");
}
