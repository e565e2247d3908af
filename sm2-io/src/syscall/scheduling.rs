//! The scheduling policy and the nice value of a thread.

use std::mem;

use nix::errno::Errno;
use nix::libc;

use super::{Call, guard};

/// Gives the calling thread the policy `SCHED_IDLE`.
pub(crate) fn set_idle() -> nix::Result<()> {
    guard(Call::SetScheduler)?;
    // SAFETY: the structure consists of integers, for which zero is a value, and the kernel only reads it. Zero names
    // the calling thread.
    let done = unsafe {
        let parameters: libc::sched_param = mem::zeroed();
        libc::sched_setscheduler(0, libc::SCHED_IDLE, &raw const parameters)
    };
    Errno::result(done).map(drop)
}

/// The nice value of the calling thread, from -20 to 19.
pub(crate) fn nice() -> nix::Result<i32> {
    // -1 is a nice value as well.
    Errno::clear();
    // SAFETY: the call takes integers. Zero names the calling thread.
    let nice = unsafe { libc::getpriority(libc::PRIO_PROCESS, 0) };
    match Errno::last_raw() {
        0 => Ok(nice),
        errno => Err(Errno::from_raw(errno)),
    }
}

/// Sets the nice value of the calling thread.
pub(crate) fn set_nice(nice: i32) -> nix::Result<()> {
    guard(Call::SetPriority)?;
    // SAFETY: as in `nice`.
    let done = unsafe { libc::setpriority(libc::PRIO_PROCESS, 0, nice) };
    Errno::result(done).map(drop)
}
