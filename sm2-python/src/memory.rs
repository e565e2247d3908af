//! Memory of SM2 that Python views, and references to Python objects.

use pyo3::ffi;
use pyo3::prelude::*;

/// The place and the length of the memory of an exporter.
pub(crate) type Memory = (*mut u8, usize);

/// How many references to an object there are.
pub(crate) fn references(object: &Bound<'_, PyAny>) -> isize {
    // SAFETY: the object is alive, and this thread has the GIL.
    unsafe { ffi::Py_REFCNT(object.as_ptr()) }
}
