//! The buffer protocol: bytes that Python lends to SM2.

use std::slice;

use pyo3::ffi;
use pyo3::prelude::*;

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
