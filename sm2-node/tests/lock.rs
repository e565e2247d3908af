//! Memory that the operating system refuses to lock. This test is alone in its file because it
//! lowers a limit of its process.

use sm2_test_support::ran_alone;
use std::io;

use crate::common::Domain;
use nix::libc;
use nix::sys::resource::{Resource, setrlimit};
use sm2_node::DeclareError;

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
fn a_refusal_says_the_limit_and_what_to_do() {
    if ran_alone(concat!(
        module_path!(),
        "::a_refusal_says_the_limit_and_what_to_do"
    )) {
        return;
    }
    let limit = 1 << 20;
    let domain = Domain::new();
    drop_capabilities();
    setrlimit(Resource::RLIMIT_MEMLOCK, limit, limit).unwrap();
    let node = domain.node("talker");
    let builder = || {
        node.publisher_builder::<[u8]>("topic")
            .max_len(100_000)
            .mlock(true)
    };

    let publisher = builder().slots(4).declare().unwrap();
    assert_eq!(publisher.publish(&[1; 100_000]).unwrap().missed, 0);
    let error = builder().slots(9).declare().unwrap_err();
    assert!(
        matches!(
            error,
            DeclareError::Lock {
                slots: 9,
                limit_bytes: 0x10_0000,
                ..
            }
        ),
        "{error}"
    );
    let text = error.to_string();
    assert!(
        text.contains("RLIMIT_MEMLOCK is 1048576 bytes") && text.contains("ulimit -l"),
        "{text}"
    );
}
