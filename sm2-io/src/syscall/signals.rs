//! The signal mask of a thread.

use nix::sys::signal::{SigSet, SigmaskHow};

/// Blocks all signals in the calling thread. Returns the mask before. Cannot fail, so no test makes it fail.
pub(crate) fn block_all() -> SigSet {
    SigSet::all()
        .thread_swap_mask(SigmaskHow::SIG_SETMASK)
        .unwrap_or_else(|_| SigSet::empty())
}

/// Sets the signal mask of the calling thread.
pub(crate) fn set_mask(mask: &SigSet) {
    let _ = mask.thread_set_mask();
}
