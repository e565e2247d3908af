//! How many descriptors this process can still open.

use std::ffi::c_int;
use std::io;

use crate::syscall::files;

/// How many more descriptors this process can open below its limit (`RLIMIT_NOFILE`). The count ends at
/// `at_most`: numbers are looked at one by one, from the smallest.
///
/// Other threads may open and close descriptors meanwhile.
///
/// # Errors
///
/// Any error of `getrlimit(2)`. None is expected.
pub fn free_descriptors(at_most: usize) -> io::Result<usize> {
    let limit = files::descriptors_max()?;
    let numbers = 0..c_int::try_from(limit).unwrap_or(c_int::MAX);
    let free = numbers.filter(|&number| !files::is_open(number));
    Ok(free.take(at_most).count())
}
