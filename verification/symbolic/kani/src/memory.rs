//! An allocator whose addresses do not depend on the content of memory.

use core::alloc::{GlobalAlloc, Layout};
use core::cell::{Cell, UnsafeCell};
use core::ptr;

const HEAP_BYTES: usize = 1 << 20;

/// Gives each allocation new memory and frees none, since paths are short.
struct Bump {
    memory: UnsafeCell<[u8; HEAP_BYTES]>,
    used: Cell<usize>,
}

// SAFETY: the engine explores one thread.
unsafe impl Sync for Bump {}

// SAFETY: allocated ranges lie inside `memory`, have the requested alignment, and are given out
// once.
unsafe impl GlobalAlloc for Bump {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        let base = self.memory.get().cast::<u8>();
        let start = (base.addr() + self.used.get()).next_multiple_of(layout.align()) - base.addr();
        match start.checked_add(layout.size()) {
            Some(end) if end <= HEAP_BYTES => {
                self.used.set(end);
                base.wrapping_add(start)
            }
            _ => ptr::null_mut(),
        }
    }

    unsafe fn dealloc(&self, _: *mut u8, _: Layout) {}
}

#[global_allocator]
static HEAP: Bump = Bump {
    memory: UnsafeCell::new([0; HEAP_BYTES]),
    used: Cell::new(0),
};

/// Starts again, for the next run of a harness.
pub(crate) fn release_all() {
    HEAP.used.set(0);
}
