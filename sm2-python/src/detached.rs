//! Calls without the GIL.

use pyo3::prelude::*;

use crate::logging;

/// Runs `call` without the GIL, and then passes queued log records on to `logging`.
///
/// A daemon thread whose call returns after the interpreter has ended gets no GIL any more: PyO3 lets it sleep until
/// the process ends. It holds no lock of SM2 then, because `call` has returned.
pub(crate) fn detached<T: Send>(py: Python<'_>, call: impl FnOnce() -> T + Send) -> T {
    let result = py.detach(call);
    logging::forward(py);
    result
}
