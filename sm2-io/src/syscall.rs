//! The seam to the kernel: all system calls of this crate.
//!
//! Each function here is one system call, with the kernel's arguments, result and error; the rest of the
//! crate decides what they mean. `tests/seam.rs` fails if a file outside of this folder makes a system
//! call. Two groups of calls are made by other crates: what `quinn-udp` and `tokio` do with the UDP
//! socket of [`quic`](crate::quic), and the deallocations and threads of the standard library.
//!
//! In a build with the feature `fault-injection`, each call first asks the thread's plan whether it has to
//! fail ([`fault`](crate::fault)). Without the feature, the question costs nothing.
//!
//! Calls that only give something back (`close`, `munmap`) or that cannot fail (`clock_gettime`,
//! `geteuid`) do not ask.

mod call;
pub(crate) mod events;
pub(crate) mod files;
pub(crate) mod fork;
pub(crate) mod memory;
pub(crate) mod processes;
pub(crate) mod scheduling;
pub(crate) mod signals;
pub(crate) mod sockets;

#[cfg(feature = "fault-injection")]
use nix::errno::Errno;

#[cfg(feature = "fault-injection")]
pub use self::call::Call;
#[cfg(not(feature = "fault-injection"))]
pub(crate) use self::call::Call;

/// Fails if the plan of a test says that this call has to.
#[cfg(feature = "fault-injection")]
pub(crate) fn guard(call: Call) -> nix::Result<()> {
    match crate::fault::next(call) {
        Some(errno) => Err(Errno::from_raw(errno)),
        None => Ok(()),
    }
}

/// Without the feature `fault-injection`, no call fails on request.
#[cfg(not(feature = "fault-injection"))]
#[inline(always)]
#[allow(
    clippy::unnecessary_wraps,
    clippy::inline_always,
    reason = "it has to vanish, and the same signature as with the feature"
)]
pub(crate) const fn guard(_call: Call) -> nix::Result<()> {
    Ok(())
}
