//! Memory that the operating system does not lock. A file of its own: it lowers a limit of its
//! process.

mod common;

use std::io;

use common::Domain;
use nix::libc;
use nix::sys::resource::{Resource, setrlimit};
use sm2_node::DeclareError;

/// The calling thread loses all that makes it more than an ordinary user's.
fn become_ordinary() {
    #[repr(C)]
    struct Header {
        version: u32,
        pid: i32,
    }
    const VERSION_3: u32 = 0x2008_0522;
    let header = Header {
        version: VERSION_3,
        pid: 0,
    };
    let none = [0_u32; 6];
    // SAFETY: both structures are what this version of the call reads, and live through it.
    let result = unsafe { libc::syscall(libc::SYS_capset, &raw const header, none.as_ptr()) };
    assert_eq!(result, 0, "{}", io::Error::last_os_error());
}

#[test]
fn a_refusal_says_the_limit_and_what_to_do() {
    let limit = 1 << 20;
    let domain = Domain::new();
    become_ordinary();
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
