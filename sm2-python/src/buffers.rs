//! The buffer protocol: memory of SM2 that Python views.
//!
//! All `unsafe` code of the package is here, in [`array`](crate::array), in [`input`](crate::input) and in
//! [`memory`](crate::memory).
//!
//! A view that Python makes owns a reference to its exporter (`Py_buffer.obj`), and the exporter owns the memory. The
//! memory of a [`Sample`] and of a [`LoanMemory`] therefore stays where it is until the last view is gone, in whatever
//! order the program drops its objects.

use std::ffi::{c_int, c_void};
use std::ptr::null_mut;

use pyo3::exceptions::PyBufferError;
use pyo3::ffi;
use pyo3::prelude::*;

use crate::array;
use crate::loan::LoanMemory;
use crate::memory::Memory;
use crate::sample::{ArrayBase, Sample};

#[pymethods]
impl Sample {
    unsafe fn __getbuffer__(
        slf: Bound<'_, Self>,
        view: *mut ffi::Py_buffer,
        flags: c_int,
    ) -> PyResult<()> {
        let memory = slf.get().memory()?;
        // SAFETY: CPython passes a view to fill, or null. The sample owns the memory as long as it exists, and SM2
        // promises that the bytes do not change meanwhile (SM2-PAY-005). The view is read-only.
        unsafe { export(slf.as_any(), view, flags, memory, true)? };
        slf.get().viewed();
        Ok(())
    }

    unsafe fn __releasebuffer__(&self, _view: *mut ffi::Py_buffer) {
        self.unviewed();
    }
}

#[pymethods]
impl ArrayBase {
    unsafe fn __getbuffer__(
        slf: Bound<'_, Self>,
        view: *mut ffi::Py_buffer,
        flags: c_int,
    ) -> PyResult<()> {
        let memory = slf.get().memory()?;
        // SAFETY: as for a sample, which `slf` owns.
        unsafe { export(slf.as_any(), view, flags, memory, true) }
    }
}

#[pymethods]
impl LoanMemory {
    unsafe fn __getbuffer__(
        slf: Bound<'_, Self>,
        view: *mut ffi::Py_buffer,
        flags: c_int,
    ) -> PyResult<()> {
        let memory = slf.get().memory()?;
        // SAFETY: CPython passes a view to fill, or null. The object owns the memory until it is published, which
        // happens only after `loan.rs` has found that nothing else refers to the object.
        unsafe { export(slf.as_any(), view, flags, memory, false) }
    }
}

impl ArrayBase {
    /// A read-only array of the bytes of the sample. `None` if `array` cannot make one.
    pub(crate) fn array(slf: Bound<'_, Self>) -> PyResult<Option<Bound<'_, PyAny>>> {
        let memory = slf.get().memory()?;
        let len = [isize::try_from(memory.1)?];
        // SAFETY: the view owns its sample, which owns the memory as long as it exists. SM2 promises that the bytes do
        // not change meanwhile (SM2-PAY-005). The array is read-only.
        unsafe { array::of_bytes(slf.into_any(), memory, &len, false) }.transpose()
    }
}

impl LoanMemory {
    /// An array of bytes with these lengths. `None` if `array` cannot make one.
    pub(crate) fn array<'py>(
        slf: &Bound<'py, Self>,
        lengths: &[isize],
    ) -> PyResult<Option<Bound<'py, PyAny>>> {
        let memory = slf.get().memory()?;
        let len = lengths
            .iter()
            .try_fold(1, |len: isize, it| len.checked_mul(*it));
        if len != Some(isize::try_from(memory.1)?) {
            return Ok(None);
        }
        // SAFETY: the array has as many bytes as the memory. The object owns the memory until it is published, which
        // happens only after `loan.rs` has found that nothing else refers to the object.
        unsafe { array::of_bytes(slf.clone().into_any(), memory, lengths, true) }.transpose()
    }
}

/// Fills a view of the memory of `owner`.
///
/// # Safety
///
/// `view` is null or valid for writes. The memory is valid for reads, and for writes unless the view is read-only, as
/// long as `owner` exists.
unsafe fn export(
    owner: &Bound<'_, PyAny>,
    view: *mut ffi::Py_buffer,
    flags: c_int,
    (data, len): Memory,
    is_read_only: bool,
) -> PyResult<()> {
    if view.is_null() {
        return Err(PyBufferError::new_err("no place for the view"));
    }
    let len = isize::try_from(len)?;
    // SAFETY: the caller promises that `view` can be written. `PyBuffer_FillInfo` keeps a reference to `owner`, so the
    // memory outlives the view, and refuses a writable view of read-only memory.
    let filled = unsafe {
        (*view).obj = null_mut();
        ffi::PyBuffer_FillInfo(
            view,
            owner.as_ptr(),
            data.cast::<c_void>(),
            len,
            c_int::from(is_read_only),
            flags,
        )
    };
    match filled {
        0 => Ok(()),
        _ => Err(PyErr::fetch(owner.py())),
    }
}
