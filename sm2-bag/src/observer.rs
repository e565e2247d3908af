//! Watching long work with bags, and ending it.

use std::ops::ControlFlow;

use crate::error::ReadError;

/// Is told again and again how many bytes were read since the last call. [`ControlFlow::Break`] ends the work with
/// [`ReadError::Stopped`].
pub type Observer<'a> = dyn FnMut(u64) -> ControlFlow<()> + 'a;

/// Lets the work go on.
pub(crate) const fn unobserved(_: u64) -> ControlFlow<()> {
    ControlFlow::Continue(())
}

/// Tells the observer about bytes that were read.
pub(crate) fn report_progress(observer: &mut Observer<'_>, bytes: u64) -> Result<(), ReadError> {
    match observer(bytes) {
        ControlFlow::Continue(()) => Ok(()),
        ControlFlow::Break(()) => Err(ReadError::Stopped),
    }
}
