//! The places where the engine takes over, and the panic handler, which leads to one of them.

use core::panic::PanicInfo;
use core::ptr;
use core::sync::atomic::{AtomicPtr, Ordering};

use crate::memory;

/// The callbacks when the library runs on the processor; `../engine/replay.py` implements them.
#[repr(C)]
struct Answers {
    any: extern "C" fn(u32) -> u64,
    assume: extern "C" fn(bool),
    cover: extern "C" fn(bool, *const u8, usize),
    panic: extern "C" fn(*const u8, usize, u32) -> !,
}

static ANSWERS: AtomicPtr<Answers> = AtomicPtr::new(ptr::null_mut());

/// Runs a harness on the processor.
///
/// # Safety
///
/// `answers` stays valid until the next call.
#[unsafe(no_mangle)]
unsafe extern "C" fn sm2_symbolic_replay(harness: extern "C" fn(), answers: *mut Answers) {
    ANSWERS.store(answers, Ordering::Relaxed);
    memory::release_all();
    harness();
}

fn answers() -> &'static Answers {
    // SAFETY: `sm2_symbolic_replay` ran before, and its caller promised that the pointer is valid.
    unsafe { &*ANSWERS.load(Ordering::Relaxed) }
}

/// A value of this many bits; higher bits are zero.
#[unsafe(no_mangle)]
#[inline(never)]
pub(crate) extern "C" fn sm2_symbolic_any(bits: u32) -> u64 {
    (answers().any)(bits)
}

#[unsafe(no_mangle)]
#[inline(never)]
pub(crate) extern "C" fn sm2_symbolic_assume(condition: bool) {
    (answers().assume)(condition);
}

#[unsafe(no_mangle)]
#[inline(never)]
pub(crate) extern "C" fn sm2_symbolic_cover(condition: bool, text: *const u8, len: usize) {
    (answers().cover)(condition, text, len);
}

/// A path that gets here has failed, at `line` of the file with this name.
#[unsafe(no_mangle)]
#[inline(never)]
extern "C" fn sm2_symbolic_panic(file: *const u8, len: usize, line: u32) -> ! {
    (answers().panic)(file, len, line)
}

#[panic_handler]
fn panicked(info: &PanicInfo<'_>) -> ! {
    let (file, line) = info.location().map_or(("", 0), |it| (it.file(), it.line()));
    sm2_symbolic_panic(file.as_ptr(), file.len(), line)
}

/// Tables of the compiled `core` refer to this symbol; nothing unwinds here.
#[unsafe(no_mangle)]
extern "C" fn rust_eh_personality() {}
