//! The payload of messages for the processes in Python, which check it by the same code as all others.

#[path = "../src/clock.rs"]
#[allow(dead_code, reason = "the processes in Python sleep by themselves")]
mod clock;
#[path = "../src/payload.rs"]
#[allow(dead_code, reason = "the processes in Python fill and check messages")]
mod payload;

use clock::now_ns;
use payload::{Header, check, fill, peek, stamp};

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

/// As `bench_fill`, with the time before and after the writing in the header of a stamped message.
///
/// # Safety
///
/// As for `bench_fill`.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn bench_write(
    message: *mut u8,
    len: usize,
    number: u64,
    flags: u64,
    stamped: bool,
) {
    let now = || if stamped { now_ns() } else { 0 };
    // SAFETY: the caller promises it.
    let message = unsafe { std::slice::from_raw_parts_mut(message, len) };
    let header = Header {
        number,
        flags,
        start_ns: now(),
        handed_ns: 0,
    };
    fill(header, message);
    stamp(message, now());
}

/// Reads a message of 32 bytes or more. Sets `found` to the four words of its header, the time of the call if it is
/// stamped, and 1 if `full` and one of its bytes is not what was written.
///
/// # Safety
///
/// `message` is valid for `len` bytes, and `found` for six words.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn bench_read(message: *const u8, len: usize, full: bool, found: *mut u64) {
    // SAFETY: the caller promises both.
    let (message, found) = unsafe {
        (
            std::slice::from_raw_parts(message, len),
            &mut *found.cast::<[u64; 6]>(),
        )
    };
    let Header {
        number,
        flags,
        start_ns,
        handed_ns,
    } = peek(message).unwrap_or_default();
    let in_hand_ns = match (start_ns, handed_ns) {
        (0, 0) => 0,
        _ => now_ns(),
    };
    let torn = full && check(message).is_err();
    *found = [
        number,
        flags,
        start_ns,
        handed_ns,
        in_hand_ns,
        u64::from(torn),
    ];
}
