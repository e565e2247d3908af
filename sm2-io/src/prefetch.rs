//! Hints for the processor: memory that is about to be read or written. On processors other than x86-64 they do
//! nothing, because Rust has no stable prefetch for these.

#[cfg(target_arch = "x86_64")]
use std::arch::x86_64::{_MM_HINT_ET0, _MM_HINT_T0, _mm_prefetch};

/// Prefetches the cache line of `line`, which is about to be read.
#[inline]
pub(crate) fn prefetch_to_read(line: *const u8) {
    // SAFETY: a prefetch reads and changes nothing, and cannot fault, wherever `line` is.
    #[cfg(target_arch = "x86_64")]
    unsafe {
        _mm_prefetch::<_MM_HINT_T0>(line.cast());
    }
    #[cfg(not(target_arch = "x86_64"))]
    let _ = line;
}

/// Prefetches the cache line of `line`, which is about to be written: takes it from the other cores.
#[inline]
pub(crate) fn prefetch_to_write(line: *const u8) {
    // SAFETY: as in `prefetch_to_read`.
    #[cfg(target_arch = "x86_64")]
    unsafe {
        _mm_prefetch::<_MM_HINT_ET0>(line.cast());
    }
    #[cfg(not(target_arch = "x86_64"))]
    let _ = line;
}
