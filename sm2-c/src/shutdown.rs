//! Ending all waits of a program.

use std::ffi::c_int;
use std::mem::MaybeUninit;

use crate::arguments::{given, store_descriptor, vacant};
use crate::status::{Status, guard, guard_drop};

/// A handle that ends all waits of a program: see `sm2_shutdown_request()`.
#[derive(Debug)]
pub struct Shutdown(pub(crate) sm2_node::Shutdown);

/// Makes a shutdown handle. Set it in `sm2_node_options_t` and with `sm2_wait_set_end_with()`.
///
/// Errors: `SM2_IO`, `SM2_MISUSE`.
///
/// Threads: any.
#[unsafe(no_mangle)]
pub extern "C" fn sm2_shutdown_new(
    shutdown: Option<&mut MaybeUninit<Option<Box<Shutdown>>>>,
) -> Status {
    guard(|| {
        let shutdown = vacant(shutdown, "shutdown")?;
        *shutdown = Some(Box::new(Shutdown(sm2_node::Shutdown::new()?)));
        Ok(())
    })
}

/// Frees a shutdown handle; NULL is ignored. Nodes and wait sets that have it keep what they need.
///
/// Threads: any, but no other call may use this handle at the same time or later: also no signal handler.
#[unsafe(no_mangle)]
pub extern "C" fn sm2_shutdown_free(shutdown: Option<Box<Shutdown>>) {
    guard_drop(shutdown);
}

/// Ends all waits of the nodes and wait sets that have this handle, now and later, with `SM2_SHUTDOWN`. Calls that do
/// not wait go on as before.
///
/// Errors: `SM2_MISUSE`.
///
/// Threads: any, at the same time, also in a signal handler if the handle is not NULL. `errno` stays as it was.
#[unsafe(no_mangle)]
pub extern "C" fn sm2_shutdown_request(shutdown: Option<&Shutdown>) -> Status {
    guard(|| {
        given(shutdown, "shutdown")?.0.request();
        Ok(())
    })
}

/// Stores in `requested` whether the shutdown was requested.
///
/// Errors: `SM2_MISUSE`.
///
/// Threads: any, at the same time.
#[unsafe(no_mangle)]
pub extern "C" fn sm2_shutdown_is_requested(
    shutdown: Option<&Shutdown>,
    requested: Option<&mut MaybeUninit<bool>>,
) -> Status {
    guard(|| {
        let shutdown = given(shutdown, "shutdown")?;
        given(requested, "requested")?.write(shutdown.0.is_requested());
        Ok(())
    })
}

/// Stores a descriptor in `fd` that is readable once the shutdown was requested. The handle keeps the descriptor; do
/// not close it.
///
/// Errors: `SM2_MISUSE`.
///
/// Threads: any, at the same time.
#[unsafe(no_mangle)]
pub extern "C" fn sm2_shutdown_descriptor(
    shutdown: Option<&Shutdown>,
    fd: Option<&mut MaybeUninit<c_int>>,
) -> Status {
    guard(|| store_descriptor(&given(shutdown, "shutdown")?.0, fd))
}
