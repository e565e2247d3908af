//! How many descriptors this process can open.

use std::ffi::c_int;
use std::io;

use crate::syscall::files;

/// How many more descriptors this process can open below its limit (`RLIMIT_NOFILE`), at most `at_most`.
///
/// One system call where the kernel counts the open ones (Linux 6.2 and later); otherwise one for each number, from the
/// smallest, until `at_most` are free.
///
/// Other threads may open and close descriptors meanwhile.
///
/// # Errors
///
/// Any error of `getrlimit(2)`. None is expected.
pub fn free_descriptors(at_most: usize) -> io::Result<usize> {
    let limit = files::descriptors_max()?;
    if let Some(open) = files::open_descriptors() {
        let free = limit.saturating_sub(open);
        return Ok(at_most.min(usize::try_from(free).unwrap_or(usize::MAX)));
    }
    let numbers = 0..c_int::try_from(limit).unwrap_or(c_int::MAX);
    let free = numbers.filter(|&number| !files::is_open(number));
    Ok(free.take(at_most).count())
}

/// Raises the soft limit of open descriptors (`RLIMIT_NOFILE`) to the hard limit. For programs that run long: other
/// processes decide how many links, topics or connections they get, and the usual soft limit is 1,024.
///
/// If the system refuses, the old limit stays, which is enough for a smaller domain.
pub fn raise_descriptor_limit() {
    let _ = files::raise_descriptors_max();
}
