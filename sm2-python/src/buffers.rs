//! The buffer protocol: bytes that Python lends to SM2, and memory of SM2 that Python views.
//!
//! All `unsafe` code of the package is here.
//!
//! A view that Python makes owns a reference to its exporter (`Py_buffer.obj`), and the exporter owns the memory. The
//! memory of a [`Sample`] and of a [`LoanMemory`] therefore stays where it is until the last view is gone, in whatever
//! order the program drops its objects.

use std::ffi::{c_int, c_void};
use std::ptr::null_mut;
use std::slice;

use pyo3::exceptions::PyBufferError;
use pyo3::ffi;
use pyo3::prelude::*;

use crate::loan::LoanMemory;
use crate::sample::Sample;

/// The bytes of a Python object with the buffer protocol, such as `bytes`, `bytearray` or a contiguous array.
pub(crate) struct Input {
    /// In a box, because exporters may refer to the structure itself.
    view: Box<ffi::Py_buffer>,
}

impl Input {
    /// The bytes. Another thread of the program may write to them meanwhile: then the message has bytes from before and
    /// from after, as with `socket.send`.
    pub(crate) fn bytes(&self) -> &[u8] {
        let len = usize::try_from(self.view.len).unwrap_or(0);
        if len == 0 {
            return &[];
        }
        // SAFETY: the exporter promised `len` contiguous bytes at `buf` (PyBUF_SIMPLE), which stay there until `drop`
        // releases the view. Every bit pattern is a `u8`. The caller only copies the bytes, so a thread of Python that
        // writes to them while the GIL is released changes no more than the copy.
        unsafe { slice::from_raw_parts(self.view.buf.cast::<u8>(), len) }
    }
}

impl<'py> FromPyObject<'_, 'py> for Input {
    type Error = PyErr;

    fn extract(object: Borrowed<'_, 'py, PyAny>) -> PyResult<Self> {
        let mut view = Box::new(ffi::Py_buffer::new());
        // SAFETY: `object` is alive and this thread has the GIL. `view` is a valid place for the result, and keeps its
        // address until it is released.
        let got =
            unsafe { ffi::PyObject_GetBuffer(object.as_ptr(), &raw mut *view, ffi::PyBUF_SIMPLE) };
        match got {
            0 => Ok(Self { view }),
            _ => Err(PyErr::fetch(object.py())),
        }
    }
}

impl Drop for Input {
    fn drop(&mut self) {
        // SAFETY: `extract` filled the view. An `Input` is an argument of a method, which drops it with the GIL.
        unsafe { ffi::PyBuffer_Release(&raw mut *self.view) };
    }
}

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

/// How many references to an object there are.
pub(crate) fn references(object: &Bound<'_, PyAny>) -> isize {
    // SAFETY: the object is alive, and this thread has the GIL.
    unsafe { ffi::Py_REFCNT(object.as_ptr()) }
}

/// The place and the length of the memory of an exporter.
pub(crate) type Memory = (*mut u8, usize);

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
