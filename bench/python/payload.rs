//! The payload of messages for the processes in Python, which check it by the same code as all others.

#[path = "../src/payload.rs"]
#[allow(dead_code, reason = "the processes in Python fill and check messages")]
mod payload;

use payload::{Header, check, fill};

/// Writes a message of `len` bytes, 32 or more.
///
/// # Safety
///
/// `message` is valid for `len` bytes, and nothing else uses them meanwhile.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn bench_fill(
    message: *mut u8,
    len: usize,
    number: u64,
    flags: u64,
    start_ns: u64,
    handed_ns: u64,
) {
    let header = Header {
        number,
        flags,
        start_ns,
        handed_ns,
    };
    // SAFETY: the caller promises it.
    fill(header, unsafe {
        std::slice::from_raw_parts_mut(message, len)
    });
}

/// Returns whether all bytes of a message are those that `bench_fill` writes.
///
/// # Safety
///
/// `message` is valid for `len` bytes.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn bench_check(message: *const u8, len: usize) -> bool {
    // SAFETY: the caller promises it.
    check(unsafe { std::slice::from_raw_parts(message, len) }).is_ok()
}
