//! The scheduling policy of a thread.

use std::mem;

use nix::errno::Errno;
use nix::libc;

use super::{Call, guard};

/// Gives the calling thread the policy `SCHED_IDLE`.
pub(crate) fn set_idle() -> nix::Result<()> {
    guard(Call::SetScheduler)?;
    // SAFETY: the structure consists of integers, where zero is a value, and the kernel only reads it. Zero names
    // the calling thread.
    let done = unsafe {
        let parameters: libc::sched_param = mem::zeroed();
        libc::sched_setscheduler(0, libc::SCHED_IDLE, &raw const parameters)
    };
    Errno::result(done).map(drop)
}
