//! Links sm2-proto into a program that has no std.
//!
//! The allocator always fails and the panic handler never returns: this is
//! built, never run. `extern "C"` functions keep the linker from dropping
//! what they call.
#![no_std]

use core::alloc::{GlobalAlloc, Layout};
use core::panic::PanicInfo;
use core::{ptr, slice};

use sm2_proto::{Datagram, Instant, control};

/// Whether these bytes are a frame that a Manager may receive.
///
/// # Safety
/// `bytes` points at `len_bytes` readable bytes.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn sm2_is_to_manager(bytes: *const u8, len_bytes: usize) -> bool {
    // SAFETY: the caller promises it.
    let bytes = unsafe { slice::from_raw_parts(bytes, len_bytes) };
    control::decode_to_manager(&Datagram::new(bytes)).is_ok()
}

/// Nanoseconds from `earlier` to `later`.
#[unsafe(no_mangle)]
pub extern "C" fn sm2_since(later: u64, earlier: u64) -> u64 {
    let since = Instant(later).since(Instant(earlier));
    u64::try_from(since.as_nanos()).unwrap_or(u64::MAX)
}

struct NoMemory;

// SAFETY: it never returns memory, which the contract allows.
unsafe impl GlobalAlloc for NoMemory {
    unsafe fn alloc(&self, _: Layout) -> *mut u8 {
        ptr::null_mut()
    }

    unsafe fn dealloc(&self, _: *mut u8, _: Layout) {}
}

#[global_allocator]
static ALLOCATOR: NoMemory = NoMemory;

#[panic_handler]
fn halt(_: &PanicInfo<'_>) -> ! {
    loop {}
}
